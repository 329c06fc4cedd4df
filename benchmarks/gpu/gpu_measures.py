# SPDX-License-Identifier: MIT
"""Figures of a GPU run: printed and written as they come, with the time that is left for more."""

import contextlib
import os
import platform
import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch

from salsanext_cli.io.files.json_files import write_json

NETWORK = "network"  # Kind of calls by which the time of others is expected
WARM_UP = {"cpu": 1, "cuda": 3}  # Calls before those that are timed
MAX_SECONDS = 6.0  # Of the calls that are timed, after the first
RESERVE_S = 2.0  # Time that stays to write the figures


@dataclass
class Figures:
    """Figures of one part of the run, in a file that is complete after each of them."""

    path: Path
    device: str
    deadline: float  # By `time.monotonic`
    rows: list[dict[str, Any]] = field(default_factory=list)
    paces: dict[str, float] = field(default_factory=dict)  # Seconds of a call per pixel, by kind
    machine: dict[str, Any] = field(default_factory=dict)

    def add(self, name: str, value: float | str, unit: str = "") -> None:
        """Print and write a figure."""
        self.rows.append({"name": name, "value": value, "unit": unit})
        print(line_of(self.rows[-1]), flush=True)
        self.write()

    def write(self) -> None:
        """Write what there is."""
        write_json(self.path, {"machine": self.machine, "figures": self.rows})

    def left(self) -> float:
        """Return the seconds that are left."""
        return self.deadline - time.monotonic()

    def has_time_for(self, name: str, seconds: float = 0.0) -> bool:
        """Return whether so many seconds are left; say what is skipped if not."""
        left = self.left() - RESERVE_S
        if left > seconds:
            return True
        needed = f"needs about {seconds:.0f} s of {max(left, 0):.0f}" if left > 0 else "no time"
        self.add(name, f"skipped: {needed} left")
        return False

    def has_time_for_calls(self, name: str, kind: str, pixels: int, passes: float = 1.0) -> bool:
        """Return whether there is time for calls of a kind; say what is skipped if not.

        Parameters
        ----------
        name : str
            Name of the figure.
        kind : str
            Kind of calls, whose time is proportional to their pixels.
        pixels : int
            Pixels of a call.
        passes : float
            Passes of the network that take as long, for a kind that was not measured yet.

        Returns
        -------
        bool
        """
        calls = WARM_UP[torch.device(self.device).type] + 1
        return self.has_time_for(name, calls * self.expected(kind, pixels, passes))

    def expected(self, kind: str, pixels: int, passes: float = 1.0) -> float:
        """Return the expected time of a call in seconds, 0 before any is known."""
        pace = self.paces.get(kind, passes * self.paces.get(NETWORK, 0.0))
        return pace * pixels

    def wait(self) -> None:
        """Wait until the device has computed all that it was given."""
        if self.device != "cpu":
            torch.cuda.synchronize(self.device)

    def seconds_of(
        self, kind: str, pixels: int, work: Callable[[], object], repetitions: int
    ) -> float:
        """Return the median time of a call of a kind in seconds, and note its pace."""
        seconds = self.seconds(work, repetitions)
        self.paces[kind] = seconds / pixels
        return seconds

    def seconds(self, work: Callable[[], object], repetitions: int) -> float:
        """Return the median time of a call in seconds, after some calls that warm up."""
        times: list[float] = []
        for _ in range(WARM_UP[torch.device(self.device).type]):
            work()
        while not times or self._has_time_for_more(times, repetitions):
            self.wait()
            start = time.perf_counter()
            work()
            self.wait()
            times.append(time.perf_counter() - start)
        return statistics.median(times)

    def _has_time_for_more(self, times: list[float], repetitions: int) -> bool:
        """Return whether a call is to be timed again."""
        is_enough = len(times) >= repetitions or sum(times) >= MAX_SECONDS
        return not is_enough and self.left() - RESERVE_S > max(times)

    @contextlib.contextmanager
    def peak_memory(self) -> Iterator[Callable[[], str]]:
        """Yield what returns the largest memory of the GPU since, as text; empty without one."""
        if self.device == "cpu":
            yield str
            return
        torch.cuda.empty_cache()
        torch.cuda.reset_peak_memory_stats(self.device)
        yield lambda: f", {torch.cuda.max_memory_allocated(self.device) / 1e9:.2f} GB"


def line_of(row: dict[str, Any]) -> str:
    """Return a figure as a line of a table."""
    value = row["value"]
    text = f"{value:,.4g}" if isinstance(value, float) else str(value)
    return f"{row['name']:56} {text:>12} {row['unit']}".rstrip()


def machine(device: str) -> dict[str, Any]:
    """Return what the figures were measured on."""
    found: dict[str, Any] = {
        "device": "cpu",
        "python": platform.python_version(),
        "torch": torch.__version__,
        "cores": os.cpu_count(),
    }
    if device != "cpu":
        properties = torch.cuda.get_device_properties(device)
        found |= {
            "device": properties.name,
            "cuda": torch.version.cuda,
            "cudnn": torch.backends.cudnn.version(),
            "memory_gb": round(properties.total_memory / 1e9, 1),
        }
    return found
