# SPDX-License-Identifier: MIT
"""Readings of a clock after each finished scan of a run."""

from collections.abc import Callable
from typing import Generic, TypeVar

Reading = TypeVar("Reading")


class FinishedScans(Generic[Reading]):
    """Progress of a run that reads a clock whenever scans are finished.

    A run also calls its progress with 0 scans, before its workers start; that call is not read.
    """

    def __init__(self, clock: Callable[[], Reading]) -> None:
        self.clock = clock
        self.counts: list[int] = []
        """Number of finished scans at each reading."""
        self.readings: list[Reading] = []

    def __call__(self, finished: int, scans: int) -> None:
        """Read the clock if scans are finished."""
        if finished:
            self.counts.append(finished)
            self.readings.append(self.clock())
