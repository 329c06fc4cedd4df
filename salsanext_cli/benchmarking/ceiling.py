# SPDX-License-Identifier: MIT
"""How fast the hardware is at best, and what that means for each part."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import torch

from salsanext_cli.network.complexity import multiply_accumulates
from salsanext_cli.network.registry import build
from salsanext_cli.network.weights import WeightsCard
from salsanext_cli.sensors import Sensor

SIDE = {"cpu": 2048, "cuda": 8192}
"""Rows of the square matrices that are multiplied."""
BYTES = {"cpu": 1 << 27, "cuda": 1 << 30}
"""Of the memory that is copied: more than any cache holds."""
TRIES = 3

POINT, INTENSITY, INDEX, RANGE, TRAIN_ID, RAW_ID = 12, 4, 4, 4, 1, 4
"""Bytes of what a point or a pixel has."""
CHANNELS = 20
"""Bytes of a pixel of a range image."""


@dataclass(frozen=True, slots=True)
class Ceiling:
    """The best that a device does.

    Attributes
    ----------
    precision : str
        Number type of the matrices, that of the network.
    operations : float
        Multiplications and additions per second in a product of matrices.
    bytes : float
        Bytes read or written per second in a copy of memory.
    """

    precision: str
    operations: float
    bytes: float

    def better(self, other: Ceiling) -> Ceiling:
        """Return the higher of both."""
        highest = max(self.operations, other.operations), max(self.bytes, other.bytes)
        return Ceiling(self.precision, *highest)

    def seconds(self, operations: int, moved: int) -> float:
        """Return how long so many operations and bytes take at least, side by side."""
        return max(operations / self.operations, moved / self.bytes)


def measure_ceiling(device: torch.device, precision: str) -> Ceiling:
    """Multiply matrices and copy memory, with the threads that torch has."""
    side, size = SIDE[device.type], BYTES[device.type]
    one, other = (
        torch.ones(side, side, device=device, dtype=getattr(torch, precision)) for _ in range(2)
    )
    source = torch.zeros(size, device=device, dtype=torch.uint8)
    target = torch.empty_like(source)
    return Ceiling(
        precision,
        2 * side**3 / _least(lambda: one @ other, device),
        2 * size / _least(lambda: target.copy_(source), device),
    )


def _least(work: Callable[[], object], device: torch.device) -> float:
    """Return the shortest time of a few; the first only warms up."""
    seconds = []
    for _ in range(1 + TRIES):
        start = time.perf_counter()
        work()
        wait(device)
        seconds.append(time.perf_counter() - start)
    return min(seconds[1:])


def wait(device: torch.device) -> None:
    """Wait until a device has done all that it was asked for."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)


def floors(card: WeightsCard, sensor: Sensor, points: int, ceiling: Ceiling) -> dict[str, float]:
    """Return by part how many seconds a scan takes at least.

    What is counted is what any program must do: read its input once, write its output once, and
    compute the network's convolutions. What it does beside counts against it.

    Parameters
    ----------
    card : WeightsCard
        Of the network.
    sensor : Sensor
        Size of the range image.
    points : int
        Of the scan.
    ceiling : Ceiling
        What the hardware can.
    """
    with torch.device("meta"):
        module = build(card.architecture).eval()
    operations = 2 * multiply_accumulates(module, sensor.height, sensor.width)
    pixels = sensor.height * sensor.width
    projection = points * (POINT + INTENSITY + INDEX + RANGE) + pixels * (CHANNELS + INDEX)
    vote = points * (INDEX + RANGE + TRAIN_ID) + pixels * (RANGE + TRAIN_ID)
    files = points * (POINT + INTENSITY + RAW_ID)
    return {
        "projection": ceiling.seconds(0, projection),
        "network": ceiling.seconds(operations, pixels * CHANNELS),
        "knn": ceiling.seconds(0, vote),
        "predict": ceiling.seconds(operations, files + projection + pixels * CHANNELS + vote),
        "confusion": ceiling.seconds(0, points * 2 * TRAIN_ID),
    }
