# SPDX-License-Identifier: MIT
"""Origin of the beams of a sensor: the point from which their elevations form a comb."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from salsanext_cli.core.records import Double, Float

BIN_DEG = 0.02
FINE_BINS, COARSE_BINS = 3, 51  # Widths of histogram averages: within a tooth, over several
DISTANCES_M = (2.0, 60.0)  # Distances of points that show the origin of the beams
FAR_M = 15.0  # Least distance of points that show its height at any position in the plane
AHEAD_M, ASIDE_M, ABOVE_M = (-3.0, 3.0), (-1.5, 1.5), (-1.0, 5.0)
"""Bounds of the sensor ahead of the origin of the files, to its left and above it."""
MAX_POINTS_OVER = 6144
OVER_M = (0.3, 4.0)  # Bounds of the height of a sensor above the ground
STEP_OF_HEIGHT_M, STEP_M, LAST_STEP_M = 0.05, 0.25, 0.01
MIN_SHARPNESS = 1.4
"""Least sharpness of a comb: sensors of 32 to 128 beams had 1.8 to 20; a Livox had 1.1."""
MIN_SHARPNESS_ELSEWHERE, MIN_GAIN = 1.6, 1.5
"""Least sharpness elsewhere than at the origin, and least factor to that at the origin.

Accumulated clouds had up to 1.4 and 1.1; sensors had at least 2.4 and 2."""
PROVING_SHARPNESS = 4.0
"""Least sharpness that proves a position without a comparison with others around it.

Far objects form a comb from wrong positions, too: 5 m aside, scans of 32 beams had up to 12."""
MIN_POINTS_OF_ORIGIN = 1000


def find_origin(points: Float) -> tuple[float, float, float] | None:
    """Return the origin of the beams by upright points (N, 3) without the ground, or None."""
    near, far = (_between(points, least, DISTANCES_M[1]) for least in (DISTANCES_M[0], FAR_M))
    at_origin = sharpness_at_origin(points)
    if at_origin > MIN_SHARPNESS:
        return 0.0, 0.0, 0.0
    if len(far) < MIN_POINTS_OF_ORIGIN:
        return None
    position = _sharpest(far, _grid((0,), (0,), np.arange(*ABOVE_M, STEP_OF_HEIGHT_M)))
    ahead, aside = (np.arange(low, high + STEP_M / 2, STEP_M) for low, high in (AHEAD_M, ASIDE_M))
    position = _sharpest(near, position + _grid(ahead, aside, (0,)))
    position = _climbed(near, position)
    sharp = sharpness(near, position) > max(MIN_SHARPNESS_ELSEWHERE, MIN_GAIN * at_origin)
    x, y, z = position.tolist()
    inside = AHEAD_M[0] < x < AHEAD_M[1] and ASIDE_M[0] < y < ASIDE_M[1]
    return (x, y, z) if inside and sharp else None


@dataclass(frozen=True, slots=True)
class BeamOrigin:
    """Position from which the elevations of points form the clearest comb of beams."""

    position: Double  # (3,) metres
    sharpness: float  # As of `sharpness`; 0 for too few points


def find_origin_over(points: Double, start: Double) -> BeamOrigin:
    """Return the sharpest position over a start (3,) on the ground, at heights of `OVER_M`.

    `points` (N, 3): points without the ground, in a frame with the axis of the sensor upright.
    """
    distances = np.hypot(*(points - start).T[:2])
    order = np.flatnonzero((distances > DISTANCES_M[0]) & (distances < DISTANCES_M[1]))
    order = order[:: -(-len(order) // MAX_POINTS_OVER) or 1]
    near, far = points[order], points[order[distances[order] > FAR_M]]
    if len(far) < MIN_POINTS_OF_ORIGIN:
        return BeamOrigin(start, 0.0)
    heights = start + _grid((0,), (0,), np.arange(*OVER_M, STEP_OF_HEIGHT_M))
    position = _climbed(near, _sharpest(far, heights))
    # The beams of some sensors start beside each other, which blurs the comb of near points.
    return BeamOrigin(position, max(sharpness(part, position) for part in (near, far)))


def _climbed(points: Double, position: Double) -> Double:
    """Return the sharpest position (3,) by ever shorter steps."""
    step = STEP_M / 2
    while step > LAST_STEP_M:
        position = _sharpest(points, position + step * _grid(*[(-1, 0, 1)] * 3))
        step /= 2
    return position


def sharpness_at_origin(points: Float) -> float:
    """Return the sharpness of upright points (N, 3) from the origin, 0 for too few points."""
    near = _between(points, *DISTANCES_M)
    return sharpness(near, np.zeros(3)) if len(near) >= MIN_POINTS_OF_ORIGIN else 0.0


def _between(points: Float, nearest: float, farthest: float) -> Double:
    """Return the points (M, 3), float64, at level distances within bounds."""
    doubles: Double = points.astype(np.float64)
    distances = np.hypot(doubles[:, 0], doubles[:, 1])
    return doubles[(distances > nearest) & (distances < farthest)]


def _grid(*axes: Sequence[float] | Double) -> Double:
    """Return all points with coordinates on three axes, (N, 3) float64."""
    mesh = np.meshgrid(*axes)
    return np.stack(mesh, axis=-1, dtype=np.float64).reshape(-1, 3)


def _sharpest(points: Double, positions: Double) -> Double:
    return max(positions, key=lambda position: sharpness(points, position))


def sharpness(points: Double, position: Double) -> float:
    """Return how clearly elevations from a position form a comb of beams; about 1 without one."""
    x, y, z = (points - position).T
    elevations = np.degrees(np.arctan2(z, np.hypot(x, y)))
    bins = ((elevations + 90) / BIN_DEG).astype(np.intp)
    histogram = np.bincount(bins, minlength=round(180 / BIN_DEG) + 1).astype(np.float64)
    fine, coarse = (_averaged(histogram, width) for width in (FINE_BINS, COARSE_BINS))
    return float(fine @ fine) / max(float(fine @ coarse), 1.0)


def _averaged(histogram: Double, width: int) -> Double:
    sums: Double = np.cumsum(np.pad(histogram, (width // 2 + 1, width // 2)))
    return (sums[width:] - sums[:-width]) / width
