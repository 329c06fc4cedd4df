# SPDX-License-Identifier: MIT
"""Visibility of points from other scans: a scan sees something there, or farther away."""

import math
from collections.abc import Iterable

import numpy as np

from salsanext_cli.core.compiled import argument, compiled
from salsanext_cli.core.geometry.projection import arctan2
from salsanext_cli.core.records import MAX_RANGE_M, Double, Float, Int

COLUMNS = 1024  # Directions of a scan around, 0.35° apart
ROWS = 256  # Directions from 45° down to 45° up
SAME_PLACE_M = 0.3  # Largest difference of ranges of the same object
GRAZING = 0.1
"""Share of the range that is added before a scan sees through: ranges differ by this within a pixel
on flat ground."""


def nearest_ranges(points: Float) -> Float:
    """Return the range of the nearest of points (N, 3) in each direction, float32, else NaN."""
    ranges = np.full(ROWS * COLUMNS, np.nan, np.float32)
    _keep_nearest(argument(points, np.float32), ranges)
    return ranges


def seen_by(places: Double, scans: Iterable[tuple[Double, Double, Float]]) -> Int:
    """Count the scans that see something at places, and those that see through.

    Parameters
    ----------
    places : (K, 3) float64
        Positions in metres.
    scans : iterable of tuple
        Rotation (3, 3), position (3,) and `nearest_ranges` of each scan.

    Returns
    -------
    (2, K) int32
        Numbers of scans that see something there, and of those that see something farther away.
    """
    counts = np.zeros((2, len(places)), np.int32)
    for rotation, place, ranges in scans:
        _count(places - place, argument(rotation, np.float64), ranges, counts)
    return counts


@compiled
def _direction(x: float, y: float, z: float) -> int:
    """Return the number of a direction, -1 outside."""
    column = int((arctan2(y, x) / math.pi + 1) / 2 * COLUMNS)
    row = math.floor((arctan2(z, math.sqrt(x * x + y * y)) / (math.pi / 2) + 0.5) * ROWS)
    return row * COLUMNS + min(column, COLUMNS - 1) if 0 <= row < ROWS else -1


@compiled
def _keep_nearest(points: Float, ranges: Float) -> None:
    for i in range(len(points)):
        x = np.float64(points[i, 0])
        y = np.float64(points[i, 1])
        z = np.float64(points[i, 2])
        distance = math.sqrt(x * x + y * y + z * z)
        if 0 < distance <= MAX_RANGE_M:
            direction = _direction(x, y, z)
            if direction >= 0 and not ranges[direction] <= distance:
                ranges[direction] = distance


@compiled
def _count(places: Double, rotation: Double, ranges: Float, counts: Int) -> None:
    for i in range(len(places)):
        a, b, c = places[i]
        x = a * rotation[0, 0] + b * rotation[1, 0] + c * rotation[2, 0]
        y = a * rotation[0, 1] + b * rotation[1, 1] + c * rotation[2, 1]
        z = a * rotation[0, 2] + b * rotation[1, 2] + c * rotation[2, 2]
        direction = _direction(x, y, z)
        if direction >= 0:
            distance = math.sqrt(x * x + y * y + z * z)
            behind = ranges[direction] - distance
            counts[0, i] += abs(behind) <= SAME_PLACE_M
            counts[1, i] += behind > SAME_PLACE_M + GRAZING * distance
