# SPDX-License-Identifier: MIT
"""Confusion by distance from the sensor: labels far away rest on few points."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.geometry.ranges import measured_ranges
from salsanext_cli.measures.confusion import Confusion
from salsanext_cli.records import Float

RING_STARTS_M = (0.0, 10.0, 20.0, 30.0, 40.0, 50.0)
"""Each ring ends where the next begins, the last one never."""

RING_NAMES = ("0–10 m", "10–20 m", "20–30 m", "30–40 m", "40–50 m", "over 50 m")


def ring_of_point(points: Float) -> npt.NDArray[np.intp]:
    """Return the ring that each point lies in.

    Parameters
    ----------
    points : (N, 3) float32
        Cartesian coordinates in metres, sensor frame.

    Returns
    -------
    (N,) int
        Index into `RING_NAMES`; -1 for points without a measurement (origin, NaN, infinity).
    """
    ranges, measured = measured_ranges(points)
    return np.where(measured, np.digitize(np.nan_to_num(ranges), RING_STARTS_M) - 1, -1)


def confusion_by_ring(
    ring: npt.NDArray[np.intp],
    truth: npt.NDArray[Any],
    predicted: npt.NDArray[Any],
    class_count: int,
) -> tuple[Confusion, ...]:
    """Count each ring on its own.

    Parameters
    ----------
    ring : (N,) int
        Ring of each point.
    truth, predicted : (N,) integer
        Train ids.
    class_count : int
        C, the number of train ids including 0.

    Returns
    -------
    tuple of Confusion
        One per name in `RING_NAMES`.
    """
    return tuple(
        Confusion(class_count).update(truth[ring == i], predicted[ring == i])
        for i in range(len(RING_NAMES))
    )
