# SPDX-License-Identifier: MIT
"""Job and device whose times are those of a clock of the tests."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

from salsanext_cli.runs.scans.scan_file import ScanFile


class TestClock:
    """Clock that stands still unless a step of a job moves it."""

    __test__ = False

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


@dataclass(kw_only=True)
class SlowJob:
    """Job whose steps take so many seconds for each scan."""

    clock: TestClock
    computing_s: float
    finishing_s: float

    def prepare(self, file: ScanFile) -> str:
        return file.stem

    def compute(self, scans: Sequence[str]) -> Sequence[str]:
        self.clock.now += self.computing_s * len(scans)
        return scans

    def finish(self, scan: str, computed: str) -> str:
        self.clock.now += self.finishing_s
        return computed


@dataclass(kw_only=True)
class DeviceTimes:
    """Stands for `DeviceTime`: times that the tests state, one of each batch."""

    times: list[float] = field(default_factory=list)

    @contextmanager
    def measured(self) -> Iterator[None]:
        yield

    def seconds(self) -> list[float]:
        return self.times
