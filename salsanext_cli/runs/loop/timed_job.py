# SPDX-License-Identifier: MIT
"""Job whose batches are timed, to tell how long the device waits for the process."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from salsanext_cli.core.engines.device_time import DeviceTime
from salsanext_cli.runs.loop.job import ScanJob
from salsanext_cli.runs.scans.scan_file import ScanFile

Clock = Callable[[], float]


@dataclass(frozen=True, slots=True, kw_only=True)
class StartedBatch:
    """Batch that was handed to the device: the time by a clock in seconds, and its scans."""

    start_s: float
    scans: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Pace:
    """Pace of one process.

    Attributes
    ----------
    seconds_per_scan : float
        Time of a scan in seconds.
    busy_share : float
        Share of it for which the device needs to compute the scan, 0…1; for the rest it waits.
        An upper bound: pauses of the device within a batch count as work.
    """

    seconds_per_scan: float
    busy_share: float


@dataclass(slots=True, kw_only=True)
class TimedJob:
    """Job that notes when it hands batches to a device, and how long the device takes.

    Attributes
    ----------
    job : ScanJob
        The three steps.
    device_time : DeviceTime
        Clock of the device.
    clock : callable
        Returns the time in seconds.
    batches : list of StartedBatch
        Batches that succeeded.
    """

    job: ScanJob[Any, Any, Any]
    device_time: DeviceTime
    clock: Clock
    batches: list[StartedBatch] = field(default_factory=list)

    def prepare(self, file: ScanFile) -> Any:
        """Prepare a scan."""
        return self.job.prepare(file)

    def compute(self, scans: Sequence[Any]) -> Sequence[Any]:
        """Compute a batch, and note its times."""
        start = self.clock()
        with self.device_time.measured():
            computed = self.job.compute(scans)
        self.batches.append(StartedBatch(start_s=start, scans=len(scans)))
        return computed

    def finish(self, scan: Any, computed: Any) -> Any:
        """Finish a scan."""
        return self.job.finish(scan, computed)

    def pace(self, warm_up: int) -> Pace | None:
        """Return the pace of the batches after the first `warm_up` scans; None for fewer than two.

        The time is that from the start of the first batch to the start of the last, whose scans
        therefore do not count. The device may wait within a batch too, for calls of a busy process;
        the fastest batch shows what it needs.
        """
        first = 0
        while first < len(self.batches) and warm_up > 0:
            warm_up -= self.batches[first].scans
            first += 1
        batches = self.batches[first:]
        if len(batches) < 2:
            return None
        elapsed = batches[-1].start_s - batches[0].start_s
        seconds = elapsed / sum(batch.scans for batch in batches[:-1])
        times = zip(self.device_time.seconds()[first:], batches, strict=True)
        needed = min(time / batch.scans for time, batch in times)
        return Pace(seconds_per_scan=seconds, busy_share=min(1.0, needed / max(seconds, 1e-9)))
