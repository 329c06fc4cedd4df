# SPDX-License-Identifier: MIT
"""Ranges of points, and which points hold a measurement."""

import sys

import numpy as np
import numpy.typing as npt

from salsanext_cli.records import Float

LARGEST = np.float32(1e6)
"""Largest range in metres, and largest intensity, that counts as a measurement of a range image."""


def measured_ranges(
    points: Float, farthest: float = sys.float_info.max
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.bool_]]:
    """Return the range of every point, and whether the point holds a measurement.

    `points` (N, 3) float32, Cartesian coordinates in metres, sensor frame; `farthest`: largest
    range in metres that is a measurement; any finite one if not given.

    Returns `ranges` (N,) float64, distances from the sensor in metres; `measured` (N,) bool, false
    for the origin, NaN, infinity and ranges beyond the farthest.
    """
    with np.errstate(invalid="ignore"):  # of a signalling NaN
        x, y, z = np.square(points.T, dtype=np.float64)
        ranges = np.sqrt(x + y + z)
    return ranges, (ranges > 0) & (ranges <= farthest)
