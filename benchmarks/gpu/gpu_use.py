# SPDX-License-Identifier: MIT
"""Share of the time in which a GPU computes, as nvidia-smi samples it."""

import statistics
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TextIO

import torch

INTERVAL_MS = 200
QUERY = ("--query-gpu=utilization.gpu", "--format=csv,noheader,nounits", f"-lms={INTERVAL_MS}")


@contextmanager
def utilisation(device: str) -> Iterator[list[float]]:
    """Yield a list that fills with the use of a GPU in %; it stays empty without nvidia-smi."""
    samples: list[float] = []
    sampler = None if device == "cpu" else started(("nvidia-smi", f"--id={gpu(device)}", *QUERY))
    if sampler is None or sampler.stdout is None:
        yield samples
        return
    reader = threading.Thread(target=read_numbers, args=(sampler.stdout, samples), daemon=True)
    reader.start()
    try:
        yield samples
    finally:
        sampler.kill()
        sampler.wait()
        reader.join()


def gpu(device: str) -> str:
    """Return what nvidia-smi calls a device: its UUID, whatever devices are visible."""
    uuid = getattr(torch.cuda.get_device_properties(device), "uuid", None)
    return f"GPU-{uuid}" if uuid else str(torch.device(device).index or 0)


def started(command: tuple[str, ...]) -> "subprocess.Popen[str] | None":
    """Start a command that prints numbers; return None if there is no such program."""
    try:
        return subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
    except OSError:
        return None


def read_numbers(stream: TextIO, numbers: list[float]) -> None:
    """Add the numbers of a stream to a list, one per line; others are skipped."""
    for line in stream:
        try:
            numbers.append(float(line))
        except ValueError:  # Such as [N/A]
            continue


def mean_text(samples: list[float]) -> float | str:
    """Return the mean of samples, or that there are none."""
    return statistics.fmean(samples) if samples else "unknown"
