# SPDX-License-Identifier: MIT
"""Plan of a run over scans: its scans, their sensor, and the size of the results."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from salsanext_cli.commands.jobs.plans.prepared_run import PreparedNetworkRun
from salsanext_cli.core.sensors.sensor import NOISE, Sensor
from salsanext_cli.runs.fit.scan_sample import sample_of_files
from salsanext_cli.runs.loop.run_options import Shard
from salsanext_cli.runs.results.folder_names import ORIGINS
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.selection import MissingResults

NPY_HEADER_BYTES = 128


@dataclass(frozen=True, slots=True, kw_only=True)
class RunPlan:
    """What a run would do.

    Attributes
    ----------
    scans : int
        Number of scans of the source.
    done : int
        Number of selected scans of the shard with results.
    todo : sequence of ScanFile
        The other selected scans of the shard. A bag that fails before its clouds are read is one.
    missing : MissingResults, optional
        Selected scans without the results that the run reads.
    points_per_scan : int, optional
        Mean number of points of up to 16 scans, evenly spaced; 0 if none can be read.
    size : int, optional
        Estimated size of all results to write in bytes, without those of ``objects`` and ``votes``.
    is_limit : bool
        Whether the results may be smaller.
    sensor : Sensor, optional
        Sensor of the range images; None for a run without.
    trained : Sensor, optional
        Sensor of the weights.
    """

    scans: int
    done: int
    todo: Sequence[ScanFile]
    missing: MissingResults | None = None
    points_per_scan: int | None = None
    size: int | None = None
    is_limit: bool = False
    sensor: Sensor | None = None
    trained: Sensor | None = None

    @classmethod
    def from_scans(
        cls,
        listed: Sequence[ScanFile],
        scans: Sequence[ScanFile],
        shard: Shard,
        is_done: Callable[[ScanFile], bool],
    ) -> "RunPlan":
        """Return the plan of a run without the size of its results.

        Parameters
        ----------
        listed, scans : sequence of ScanFile
            All scans of the source, and those that were selected.
        shard : Shard
            Share of the selected scans.
        is_done : callable
            Function of a scan that returns whether it has its results.
        """
        scans_of_shard = shard.select(scans)
        todo = [scan for scan in scans_of_shard if not is_done(scan)]
        return cls(scans=len(listed), done=len(scans_of_shard) - len(todo), todo=todo)

    @classmethod
    def from_network_run(cls, prepared: PreparedNetworkRun, shard: Shard) -> "RunPlan":
        """Return the plan of a run of a network."""
        network = prepared.network
        run = prepared.foreseen()
        plan = cls.from_scans(prepared.listed, prepared.scans, shard, run.is_done)
        return plan.with_results(
            prepared.scans,
            prepared.folders,
            network.sensor,
            trained=network.card.sensor,
            class_count=network.space.class_count,
        )

    def with_results(
        self,
        scans: Sequence[ScanFile],
        folders: Iterable[str],
        sensor: Sensor,
        *,
        trained: Sensor | None = None,
        class_count: int = 0,
    ) -> "RunPlan":
        """Return the plan with the size of the results.

        Parameters
        ----------
        scans : sequence of ScanFile
            Scans of which some are read.
        folders : iterable of str
            Folders of the results.
        sensor, trained : Sensor
            As of the plan.
        class_count : int
            Number of classes of a softmax.
        """
        points = mean_points(scans, sensor)
        size = bytes_of_results(folders, points, sensor, class_count)
        return replace(
            self, points_per_scan=points, size=len(self.todo) * size, sensor=sensor, trained=trained
        )

    def lines(self) -> list[str]:
        """Return further lines that state what the run would do."""
        return []

    def to_dict(self) -> dict[str, object]:
        """Return plain data for JSON."""
        data: dict[str, object] = {
            "dry_run": True,
            "found": self.scans,
            "complete": self.done,
            "todo": len(self.todo),
            "points_per_scan": self.points_per_scan,
            "bytes": self.size,
            "sensor": self.sensor and self.sensor.to_dict(NOISE),
        }
        return data | self.missing.to_dict() if self.missing else data


def mean_points(scans: Sequence[ScanFile], sensor: Sensor) -> int:
    """Return the mean number of points of up to 16 scans, evenly spaced; 0 if none is readable."""
    sample = sample_of_files(scans, sensor).scans
    return round(np.mean([len(scan) for scan in sample])) if sample else 0


def bytes_of_results(
    folders: Iterable[str], points: int, sensor: Sensor, class_count: int = 0
) -> int:
    """Return the size of the results of a scan with so many points, in bytes."""
    return sum(_result_bytes(folder, points, sensor, class_count) for folder in folders)


def _result_bytes(folder: str, points: int, sensor: Sensor, class_count: int) -> int:
    """Return the size of a result of a scan with so many points, in bytes; 0 if unknown."""
    if folder.startswith("uncertainty/"):
        return NPY_HEADER_BYTES + 4 * points
    pixels = sensor.height * sensor.width
    sizes = {
        "predictions": 4 * points,
        "probabilities": NPY_HEADER_BYTES + 2 * points * class_count,
        "pixel_labels": NPY_HEADER_BYTES + pixels,
        "range": NPY_HEADER_BYTES + 4 * 5 * pixels,
        "pixels": NPY_HEADER_BYTES + 4 * points,
        "views": NPY_HEADER_BYTES + 2 * points,
        ORIGINS: NPY_HEADER_BYTES + 24,
    }
    return sizes.get(folder, 0)
