# SPDX-License-Identifier: MIT
"""Origin of the beams of a sensor: the point from which their elevations form a comb."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.compiled import argument, compiled
from salsanext_cli.core.geometry.projection import arctan2
from salsanext_cli.core.records import Double, Float

BIN_DEG = 0.02
BINS = round(180 / BIN_DEG) + 1
FINE_BINS = 3  # Width of a histogram average within a tooth of the comb
COARSE_BINS = 51  # The same over several teeth
MARGIN_BINS = COARSE_BINS // 2 + 1
"""Empty bins at both ends of a histogram, so that each bin has as many on either side."""
DISTANCES_M = (2.0, 60.0)  # Distances of points that show the origin of the beams
FAR_M = 15.0  # Least distance of points that show its height at any position in the plane
AHEAD_M = (-3.0, 3.0)  # Bounds of the sensor ahead of the origin of the files
ASIDE_M = (-1.5, 1.5)  # Bounds to the left of it
ABOVE_M = (-1.0, 5.0)  # Bounds above it
MAX_POINTS_OVER = 6144
OVER_M = (0.3, 4.0)  # Bounds of the height of a sensor above the ground
STEP_OF_HEIGHT_M = 0.05  # Step of the first search along the vertical
STEP_M = 0.25  # Step of the first search in the plane
LAST_STEP_M = 0.01  # Shortest step
MIN_SHARPNESS = 1.4
"""Least sharpness of a comb: sensors of 32 to 128 beams had 1.8 to 20; a Livox had 1.1."""
MIN_SHARPNESS_ELSEWHERE = 1.6
"""Least sharpness elsewhere than at the origin; accumulated clouds had up to 1.4, sensors at least
2.4."""
MIN_GAIN = 1.5
"""Least factor to the sharpness at the origin; accumulated clouds had up to 1.1, sensors at least
2."""
PROVING_SHARPNESS = 4.0
"""Least sharpness that proves a position without a comparison with others around it.

Far objects form a comb from wrong positions, too: 5 m aside, scans of 32 beams had up to 12."""
MIN_POINTS_OF_ORIGIN = 1000


def find_origin(points: Float) -> tuple[float, float, float] | None:
    """Return the origin of the beams near the origin of the files.

    Parameters
    ----------
    points : (N, 3) float32
        Upright points without the ground, in metres.

    Returns
    -------
    tuple of float or None
        Three coordinates in metres; None if no position is clearly the sharpest.
    """
    nearest, farthest = DISTANCES_M
    near = _between(points, nearest, farthest)
    far = _between(points, FAR_M, farthest)
    at_origin = sharpness_at_origin(points)
    if at_origin > MIN_SHARPNESS:
        return 0.0, 0.0, 0.0
    if len(far) < MIN_POINTS_OF_ORIGIN:
        return None
    heights = np.arange(ABOVE_M[0], ABOVE_M[1], STEP_OF_HEIGHT_M)
    position = _sharpest(far, _grid((0,), (0,), heights))
    ahead = np.arange(AHEAD_M[0], AHEAD_M[1] + STEP_M / 2, STEP_M)
    aside = np.arange(ASIDE_M[0], ASIDE_M[1] + STEP_M / 2, STEP_M)
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
    """Return the sharpest position over a start on the ground, at heights of `OVER_M`.

    Parameters
    ----------
    points : (N, 3) float64
        Points without the ground in metres, in a frame with the axis of the sensor upright.
    start : (3,) float64
        Position on the ground in metres.

    Returns
    -------
    BeamOrigin
    """
    aside = points - start
    distances = np.hypot(aside[:, 0], aside[:, 1])
    nearest, farthest = DISTANCES_M
    sample = np.flatnonzero((distances > nearest) & (distances < farthest))
    step = -(-len(sample) // MAX_POINTS_OVER) or 1
    sample = sample[::step]
    near = points[sample]
    far = points[sample[distances[sample] > FAR_M]]
    if len(far) < MIN_POINTS_OF_ORIGIN:
        return BeamOrigin(start, 0.0)
    heights = np.arange(OVER_M[0], OVER_M[1], STEP_OF_HEIGHT_M)
    position = _climbed(near, _sharpest(far, start + _grid((0,), (0,), heights)))
    # The beams of some sensors start beside each other, which blurs the comb of near points.
    return BeamOrigin(position, max(sharpness(near, position), sharpness(far, position)))


def _climbed(points: Double, position: Double) -> Double:
    """Return the sharpest position (3,) by ever shorter steps."""
    directions = _grid((-1, 0, 1), (-1, 0, 1), (-1, 0, 1))
    step = STEP_M / 2
    while step > LAST_STEP_M:
        position = _sharpest(points, position + step * directions)
        step /= 2
    return position


def sharpness_at_origin(points: Float) -> float:
    """Return the sharpness of upright points (N, 3) from the origin, 0 for too few points."""
    nearest, farthest = DISTANCES_M
    near = _between(points, nearest, farthest)
    return sharpness(near, np.zeros(3)) if len(near) >= MIN_POINTS_OF_ORIGIN else 0.0


def _between(points: Float, nearest: float, farthest: float) -> Double:
    """Return the points (M, 3), float64, at level distances within bounds."""
    doubles: Double = points.astype(np.float64)
    distances = np.hypot(doubles[:, 0], doubles[:, 1])
    return doubles[(distances > nearest) & (distances < farthest)]


Coordinates = Sequence[float] | Double


def _grid(x: Coordinates, y: Coordinates, z: Coordinates) -> Double:
    """Return all points with these coordinates, (N, 3) float64."""
    mesh = np.meshgrid(x, y, z)
    return np.stack(mesh, axis=-1, dtype=np.float64).reshape(-1, 3)


def _sharpest(points: Double, positions: Double) -> Double:
    """Return the sharpest of positions (K, 3), the first in a tie."""
    return max(positions, key=lambda position: sharpness(points, position))


def sharpness(points: Double, position: Double) -> float:
    """Return how clearly elevations from a position form a comb of beams.

    Parameters
    ----------
    points : (N, 3) float64
        Coordinates in metres.
    position : (3,) float64
        Position in metres.

    Returns
    -------
    float
        About 1 without a comb.
    """
    coordinates = argument(points, np.float64).reshape(-1)
    histogram = histogram_of_elevations(coordinates, argument(position, np.float64))
    return float(sharpness_of_histogram(histogram))


@compiled
def histogram_of_elevations(points: Double, position: Double) -> npt.NDArray[np.int64]:
    """Return how many points have an elevation in each bin, from a position.

    Parameters
    ----------
    points : (3 N,) float64
        Coordinates in metres, point by point.
    position : (3,) float64
        Position in metres.

    Returns
    -------
    (BINS + 2 MARGIN_BINS,) int64
    """
    count = len(points) // 3
    bins = np.empty(count, np.int32)
    # Without branches the loop is vectorised.
    for i in range(count):
        x = points[3 * i] - position[0]
        y = points[3 * i + 1] - position[1]
        z = points[3 * i + 2] - position[2]
        elevation = arctan2(z, math.sqrt(x * x + y * y)) * (180 / math.pi)
        # A point that is not finite has no bin.
        is_finite = x * x + y * y + z * z < np.inf
        bins[i] = np.int32((elevation + 90) / BIN_DEG) if is_finite else -1
    histogram = np.zeros(BINS + 2 * MARGIN_BINS, np.int64)
    for i in range(count):
        if bins[i] >= 0:
            histogram[bins[i] + MARGIN_BINS] += 1
    return histogram


@compiled
def sharpness_of_histogram(histogram: npt.NDArray[np.int64]) -> float:
    """Return the sharpness of a histogram (BINS + 2 MARGIN_BINS,) of elevations."""
    fine = 0
    coarse = 0
    fine_squares = 0
    products = 0
    for i in range(len(histogram) - MARGIN_BINS):
        fine += histogram[i + FINE_BINS // 2]
        coarse += histogram[i + COARSE_BINS // 2]
        if i >= MARGIN_BINS:
            fine -= histogram[i - FINE_BINS // 2 - 1]
            coarse -= histogram[i - COARSE_BINS // 2 - 1]
            fine_squares += fine * fine
            products += fine * coarse
    averaged_squares = fine_squares / FINE_BINS**2
    averaged_products = products / (FINE_BINS * COARSE_BINS)
    return averaged_squares / max(averaged_products, 1.0)
