# SPDX-License-Identifier: MIT
"""Rings of distance from the sensor, in which predictions are scored."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from salsanext_cli.geometry.ranges import measured_ranges
from salsanext_cli.records import Float

RING_STARTS_M = (0.0, 10.0, 20.0, 30.0, 40.0, 50.0)
"""Inner radius of each ring, in metres; the last ring has no end."""

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
