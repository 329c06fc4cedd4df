# SPDX-License-Identifier: MIT
"""Time and memory of one side of a benchmark, in its process."""

from __future__ import annotations

import statistics
import time
from pathlib import Path

from salsanext_cli.benchmarking.ceiling import Ceiling, measure_ceiling, wait
from salsanext_cli.benchmarking.machine import Machine
from salsanext_cli.benchmarking.memory import forget_peak, peak_memory
from salsanext_cli.benchmarking.result import Turn
from salsanext_cli.benchmarking.sides import Baseline, Parts, Product, Task
from salsanext_cli.inference.network import choose_device
from salsanext_cli.storage.layout import ScanFile

ENOUGH = 0.3
"""Seconds that a turn lasts at least: what is quicker is repeated, and the median counts."""


class Watch:
    """A side, what it keeps of the scans that it has seen, and a watch."""

    def __init__(self, side: str, task: Task) -> None:
        self.device = choose_device(task.network.device)
        self.side = Baseline(task) if side == "baseline" else Product(task)
        self.parts: dict[Path, Parts] = {}
        self.warm: set[str] = set()

    def machine(self) -> Machine:
        """Say what this process computes with."""
        return Machine.here(self.device)

    def ceiling(self, precision: str) -> Ceiling:
        """Measure the hardware."""
        return measure_ceiling(self.device, precision)

    def precision(self) -> str:
        """Say in which numbers the network computes."""
        return self.side.precision

    def turn(self, part: str, file: ScanFile) -> Turn:
        """Measure a part; before its first turn, do it once."""
        if part != "predict" and file.path not in self.parts:
            self.parts[file.path] = self.side.parts(file)
        if part not in self.warm:
            self.warm.add(part)
            self.seconds(part, file, 0)
        forget_peak(self.device)
        seconds = self.seconds(part, file, ENOUGH)
        return Turn(seconds, *peak_memory(self.device))

    def seconds(self, part: str, file: ScanFile, enough: float) -> float:
        """Return how long a part takes, which is repeated until enough time has passed."""
        if part == "predict":
            return self.side.predict()
        work, times = self.parts[file.path][part]
        seconds: list[float] = []
        while not seconds or sum(seconds) < enough:
            wait(self.device)
            start = time.perf_counter()
            work()
            wait(self.device)
            seconds.append(time.perf_counter() - start)
        return statistics.median(seconds) * times
