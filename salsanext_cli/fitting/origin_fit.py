# SPDX-License-Identifier: MIT
"""Place of a sensor in the frame of its files, found from the cones that its beams draw.

Seen from the sensor, all points of a beam have one elevation, so that the histogram of elevations
is a comb of as many teeth as there are beams; seen from elsewhere, its teeth blur.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from salsanext_cli.records import Float

Double = npt.NDArray[np.float64]

BIN_DEG = 0.02
FINE_BINS, COARSE_BINS = 3, 51
"""Widths of the two averages of the histogram: within a tooth, and over several."""
DISTANCES_M = (2.0, 60.0)
"""Nearest and farthest points: the farther, the less a place's error turns them."""
FAR_M = 15.0
"""Least distance of points that tell the height whatever the place in the plane is."""
ABOVE_M = (-1.0, 5.0)
AHEAD_M = (-3.0, 3.0)
ASIDE_M = (-1.5, 1.5)
"""Box in which the sensor is sought, above the origin of the files, ahead of it and to its left."""
STEP_OF_HEIGHT_M, STEP_M, LAST_STEP_M = 0.05, 0.25, 0.01
MIN_SHARPNESS = 1.4
"""Least sharpness of a comb: sensors of 32 to 128 beams had 1.8 to 20 at their place, clouds of
no single sensor 1.1 anywhere. A Livox, whose points are no cones, had 1.1 at its place, and more
only at an edge of the box."""
MIN_POINTS = 1000


def find_origin(points: Float) -> tuple[float, float, float] | None:
    """Return the place of the sensor that the points are seen from, None where no comb is found.

    `points` (N, 3) float32, in metres, z up; of one scan, or of several of one sensor. Without
    those of the ground, which has one elevation as seen from a place on it.

    Returns x, y, z in the frame of the points, within some centimetres.
    """
    doubles: Double = points.astype(np.float64)
    distances = np.hypot(doubles[:, 0], doubles[:, 1])
    near, far = (
        doubles[(distances > least) & (distances < DISTANCES_M[1])]
        for least in (DISTANCES_M[0], FAR_M)
    )
    if len(near) >= MIN_POINTS and sharpness(near, np.zeros(3)) > MIN_SHARPNESS:
        return 0.0, 0.0, 0.0
    if len(far) < MIN_POINTS:
        return None
    place = _sharpest(far, _grid((0,), (0,), np.arange(*ABOVE_M, STEP_OF_HEIGHT_M)))
    place = _sharpest(near, place + _grid(_steps(AHEAD_M), _steps(ASIDE_M), (0,)))
    step = STEP_M / 2
    while step > LAST_STEP_M:
        place = _sharpest(near, place + step * _grid(*[(-1, 0, 1)] * 3))
        step /= 2
    sharpest = sharpness(near, place)
    x, y, z = place.tolist()
    inside = AHEAD_M[0] < x < AHEAD_M[1] and ASIDE_M[0] < y < ASIDE_M[1]
    return (x, y, z) if inside and sharpest > MIN_SHARPNESS else None


def _steps(edges: tuple[float, float]) -> Double:
    return np.arange(edges[0], edges[1] + STEP_M / 2, STEP_M)


def _grid(*axes: Sequence[float] | Double) -> Double:
    """Return all places with coordinates on three axes, (N, 3)."""
    mesh = np.meshgrid(*axes)
    return np.stack(mesh, axis=-1, dtype=np.float64).reshape(-1, 3)


def _sharpest(points: Double, places: Double) -> Double:
    found: Double = max(places, key=lambda place: sharpness(points, place))
    return found


def sharpness(points: Double, place: Double) -> float:
    """Return how sharp the comb of elevations seen from a place is; about 1 where there is none.

    It is the mean height of the histogram over that of its neighbourhood, each point counting
    once.
    """
    x, y, z = (points - place).T
    elevations = np.degrees(np.arctan2(z, np.hypot(x, y)))
    bins = ((elevations + 90) / BIN_DEG).astype(np.intp)
    histogram = np.bincount(bins, minlength=round(180 / BIN_DEG) + 1).astype(np.float64)
    fine, coarse = (_averaged(histogram, width) for width in (FINE_BINS, COARSE_BINS))
    return float(fine @ fine / (fine @ coarse))


def _averaged(histogram: Double, width: int) -> Double:
    sums: Double = np.cumsum(np.pad(histogram, (width // 2 + 1, width // 2)))
    return (sums[width:] - sums[:-width]) / width
