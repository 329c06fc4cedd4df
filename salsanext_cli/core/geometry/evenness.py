# SPDX-License-Identifier: MIT
"""Evenness of the directions in which points lie, by which a position is judged.

The beams of a rotating sensor leave it evenly in all directions. So the points of a scan are spread
evenly over the directions from the sensor, and crowded, or one behind the other, from elsewhere.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from salsanext_cli.core.compiled import argument, compiled
from salsanext_cli.core.geometry.point_sample import few_points, measured_ranges
from salsanext_cli.core.geometry.projection import arctan2
from salsanext_cli.core.geometry.sectors import SECTORS, sector_of_points
from salsanext_cli.core.records import MAX_RANGE_M, Double, Scan

FEW_POINTS = 4096  # Points that show whether a scan is seen from a position
MIN_POINTS = 1000  # Fewest points that show a position
COLUMNS = 362  # Cells of one degree around, with an offset
ROWS = 182  # The same from straight down to straight up
VEHICLE_M = 3.0  # Nearer points may be the vehicle
EMPTY = 0.25  # Share of the mean points below which a sector is empty
ROUND = 0.6  # Least share of sectors with points of a sensor that turns; the others see a fan
CROWDED = 3.0  # Most points of a sector, as a multiple of the mean, around a sensor that turns
CROWDED_NEARBY = 1.65
"""The same from which positions nearby are compared in any case; correct scans had up to 2.1."""
CROWDED_FAN = 2.2  # The same within a fan; solid-state sensors had 1.2 to 1.7
NEARBY_M = 3.0  # Distance from the origin of the positions around it
NEARBY_POSITIONS = 8
GAIN_NEARBY = 1.02
"""Least factor of the evenness nearby to that at the origin; correct scans had up to 1.01."""
HIDDEN = 0.38  # Largest share of hidden points of a fan; real ones had up to 0.34
HIDDEN_M = 1.0  # A point is hidden if it is so much farther than the nearest of its cell, and
HIDDEN_SHARE = 0.05  # this share of its range besides
FARTHEST_NEAR_M = 40.0  # Largest 1 % quantile of ranges; a sensor sees something nearby
MIN_FAR_M = 15.0  # Least 99 % quantile of ranges outdoors


@dataclass(frozen=True, slots=True, kw_only=True)
class Sectors:
    """Numbers of points in the sectors around a position."""

    occupied: float  # Share of the sectors that are not empty, 0…1
    fullest: float  # Points of the fullest sector, as a multiple of the mean

    @property
    def is_fan(self) -> bool:
        """Whether they cover only a part of the circle."""
        return self.occupied < ROUND

    @property
    def is_crowded_fan(self) -> bool:
        """Whether the fullest sector has more points than those of a solid-state sensor."""
        return self.fullest * self.occupied > CROWDED_FAN


def is_out_of_place(scan: Scan, *, nearby: bool = True) -> bool:
    """Return whether the points of an upright scan seem to be seen from elsewhere than the origin.

    The search around the origin is skipped without `nearby` if the directions are even enough.
    """
    points = measured_positions(few_points(scan, FEW_POINTS))
    if not _are_outdoors(points):
        return False
    if _are_far(points):
        return True
    sectors = sectors_around(points)
    if sectors.is_fan:
        return (
            sectors.is_crowded_fan
            or hidden_share(argument(points, np.float64).reshape(-1)) > HIDDEN
        )
    if sectors.fullest > CROWDED:
        return True
    if not nearby and sectors.fullest < CROWDED_NEARBY:
        return False
    angles = np.arange(NEARBY_POSITIONS) * 2 * np.pi / NEARBY_POSITIONS
    level = np.zeros(NEARBY_POSITIONS)
    ring = NEARBY_M * np.stack([np.cos(angles), np.sin(angles), level], axis=1)
    best = max(evenness(points, position) for position in ring)
    return best > GAIN_NEARBY * evenness(points, np.zeros(3))


def is_outdoors(scan: Scan) -> bool:
    """Return whether a scan has enough points, and far ones."""
    return _are_outdoors(measured_positions(few_points(scan, FEW_POINTS)))


def is_far(scan: Scan) -> bool:
    """Return whether a scan has no points near the origin, which every sensor sees."""
    points = measured_positions(few_points(scan, FEW_POINTS))
    return len(points) >= MIN_POINTS and _are_far(points)


def is_fan(scan: Scan) -> bool:
    """Return whether the points of an upright scan cover only a part of the circle."""
    return _sectors_of(scan).is_fan


def is_even_fan(scan: Scan) -> bool:
    """Return whether an upright scan is a fan with its points spread as from the tip.

    The tip may have any height.
    """
    sectors = _sectors_of(scan)
    return sectors.is_fan and not sectors.is_crowded_fan


def _sectors_of(scan: Scan) -> Sectors:
    """Count a sample of the points of an upright scan in the sectors around the origin."""
    return sectors_around(measured_positions(few_points(scan, FEW_POINTS)))


def _are_outdoors(points: Double) -> bool:
    return len(points) >= MIN_POINTS and bool(np.quantile(_ranges(points), 0.99) >= MIN_FAR_M)


def _are_far(points: Double) -> bool:
    return bool(np.quantile(_ranges(points), 0.01) > FARTHEST_NEAR_M)


def _ranges(points: Double) -> Double:
    return np.sqrt(np.einsum("nk,nk->n", points, points))


def evenness(points: Double, position: Double, offsets: Sequence[float] = (0.0,)) -> float:
    """Return how evenly points are spread over the directions from a position.

    It is the share of farther points, divided by their mean number in the cell of a point.

    Parameters
    ----------
    points : (N, 3) float64
        Coordinates in metres.
    position : (3,) float64
        Position in metres.
    offsets : sequence of float
        Offsets, 0…1, at which the cells begin; the mean over several has less noise.

    Returns
    -------
    float
        Evenness, 0…1.
    """
    coordinates = argument(points, np.float64).reshape(-1)
    seen_from = argument(position, np.float64)
    return float(mean_evenness(coordinates, seen_from, np.array(offsets, np.float64)))


@compiled
def mean_evenness(points: Double, position: Double, offsets: Double) -> float:
    """Return the evenness of points (3 N,) from a position (3,), the mean over K offsets of cells.

    Coordinates are in metres, point by point.
    """
    around, upwards, ranges = directions(points, position)
    count = len(ranges)
    # A point that is not finite has no cell.
    is_far = (ranges > VEHICLE_M) & (ranges < np.inf)
    far_count = is_far.sum()
    counts = np.empty(COLUMNS * ROWS, np.int32)
    total = 0.0
    for offset in offsets:
        counts[:] = 0
        squares = 0  # Sum over the cells
        for i in range(count):
            if is_far[i]:
                cell = cell_at(around[i] + offset, upwards[i] + offset)
                # (n + 1)² is n² + 2 n + 1.
                squares += 2 * counts[cell] + 1
                counts[cell] += 1
        points_beside = max(squares, 1) / max(far_count, 1)
        total += far_count / max(count, 1) / points_beside
    return total / len(offsets)


@compiled
def directions(points: Double, position: Double) -> tuple[Double, Double, Double]:
    """Return azimuth and elevation, in degrees from 0, and range of each point, 3 × (N,) float64.

    Parameters
    ----------
    points : (3 N,) float64
        Coordinates, point by point, in metres.
    position : (3,) float64
        Position from which the directions are, in metres.
    """
    count = len(points) // 3
    around = np.empty(count)
    upwards = np.empty(count)
    ranges = np.empty(count)
    # Without branches the loop is vectorised.
    for i in range(count):
        x = points[3 * i] - position[0]
        y = points[3 * i + 1] - position[1]
        z = points[3 * i + 2] - position[2]
        flat = math.sqrt(x * x + y * y)
        around[i] = arctan2(y, x) * (180 / math.pi) + 180
        upwards[i] = arctan2(z, flat) * (180 / math.pi) + 90
        ranges[i] = math.sqrt(x * x + y * y + z * z)
    return around, upwards, ranges


@compiled
def cell_at(around: float, upwards: float) -> int:
    """Return the cell of a direction in degrees from 0."""
    return int(around) * ROWS + int(upwards)


@compiled
def hidden_share(points: Double) -> float:
    """Return the share of points far behind the nearest one of their direction, 0…1.

    `points`: finite coordinates (3 N,), point by point, in metres from the position.
    """
    around, upwards, ranges = directions(points, np.zeros(3))
    count = len(ranges)
    nearest = np.full(COLUMNS * ROWS, np.inf)
    for i in range(count):
        cell = cell_at(around[i], upwards[i])
        nearest[cell] = min(nearest[cell], ranges[i])
    hidden = 0
    for i in range(count):
        limit = HIDDEN_M + (1 + HIDDEN_SHARE) * nearest[cell_at(around[i], upwards[i])]
        hidden += ranges[i] > limit
    return hidden / max(count, 1)


def sectors_around(points: Double) -> Sectors:
    """Count the points (N, 3) in the sectors around the origin."""
    far = points[np.einsum("nk,nk->n", points, points) > VEHICLE_M**2]
    counts = np.bincount(sector_of_points(far), minlength=SECTORS)
    mean = max(len(far), 1) / SECTORS
    occupied = float((counts > EMPTY * mean).mean())
    return Sectors(occupied=occupied, fullest=float(counts.max() / mean))


def measured_positions(scan: Scan) -> Double:
    """Return the measured points (M, 3) of a scan, float64."""
    measured = measured_ranges(scan.points, float(MAX_RANGE_M))[1]
    positions: Double = scan.points[measured].astype(np.float64)
    return positions
