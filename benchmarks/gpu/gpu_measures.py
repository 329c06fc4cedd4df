# SPDX-License-Identifier: MIT
"""Figures of a GPU run: printed and written as they come, with the time that is left for more."""

import contextlib
import os
import platform
import statistics
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch

from salsanext_cli.io.files.json_files import write_json

UTILISATION_INTERVAL_S = 0.2
WARM_UP = {"cpu": 1, "cuda": 3}  # Calls before those that are timed
MAX_SECONDS = 6.0  # Of the calls that are timed, after the first


@dataclass
class Figures:
    """Figures of one part of the run, in a file that is complete after each of them."""

    path: Path
    device: str
    deadline: float  # By `time.monotonic`
    rows: list[dict[str, Any]] = field(default_factory=list)
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
        if self.left() > seconds:
            return True
        self.add(name, "skipped: no time is left")
        return False

    def wait(self) -> None:
        """Wait until the device has computed all that it was given."""
        if self.device != "cpu":
            torch.cuda.synchronize(self.device)

    def seconds(self, work: Callable[[], object], repetitions: int) -> float:
        """Return the median time of a call in seconds, after some calls that warm up."""
        times: list[float] = []
        for _ in range(WARM_UP[torch.device(self.device).type]):
            work()
        while len(times) < repetitions and sum(times) < MAX_SECONDS:
            self.wait()
            start = time.perf_counter()
            work()
            self.wait()
            times.append(time.perf_counter() - start)
        return statistics.median(times)

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


@contextlib.contextmanager
def utilisation(device: str) -> Iterator[list[float]]:
    """Yield a list that fills with the share of time in which the GPU computed, in %.

    It stays empty without a GPU, or without nvidia-ml-py.
    """
    samples: list[float] = []
    ended = threading.Event()

    def watch() -> None:
        while not ended.wait(UTILISATION_INTERVAL_S):
            try:
                samples.append(float(torch.cuda.utilization(device)))
            except (ImportError, RuntimeError):  # ModuleNotFoundError without nvidia-ml-py
                return

    thread = threading.Thread(target=watch, daemon=True)
    if device != "cpu":
        thread.start()
    try:
        yield samples
    finally:
        ended.set()
        if device != "cpu":
            thread.join()


def mean_text(samples: list[float]) -> float | str:
    """Return the mean of samples, or that there are none."""
    return statistics.fmean(samples) if samples else "unknown"
