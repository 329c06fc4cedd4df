# SPDX-License-Identifier: MIT
"""Structure of a scan that shows several scans in one, noise, fog and snow, without labels.

A single sensor sees the nearest surface in each direction. Its neighbouring ranges differ little,
and few of its points lie alone in front of everything around.
"""

from dataclasses import dataclass

import numpy as np

from salsanext_cli.core.checks.further_returns import count_further_returns
from salsanext_cli.core.compiled import compiled
from salsanext_cli.core.geometry.directions import COLUMNS, NO_CELL, ROWS, direction_grid
from salsanext_cli.core.geometry.point_sample import sample_places
from salsanext_cli.core.geometry.scan_traits import MIN_TRAIT_POINTS
from salsanext_cli.core.records import Double, Float, Int, Mask, Scan
from salsanext_cli.core.sensors.sensor import Sensor

MAX_POINTS = 8192  # Points in a sample of a scan
MIN_SURROUNDING = 5  # Fewest occupied cells, of 3 × 3, that show the surface around a point
HIDDEN_M = 1.0  # Least distance of a hidden point behind that surface
HIDDEN_SHARE = 0.05  # The same as a share of the range of the surface
MIN_AROUND = 4  # Fewest other occupied cells, of 3 × 5, around a point in the air
IN_AIR_M = 0.5  # Least distance of a point in the air in front of them
IN_AIR_SHARE = 0.05  # The same as a share of its range
NEAR_M = 15.0  # Largest range of a point in the air


@dataclass(frozen=True, slots=True)
class ScanStructure:
    """Structure of the measured points of a scan, estimated from a sample."""

    hidden: float  # Share, 0…1, of points behind all surfaces around, but for further returns
    in_air: float  # Share, 0…1, of the points near the sensor and in front of all around
    roughness: float  # Median deviation of a range from the mean of its two neighbours, relative


def structure_of(scan: Scan, sensor: Sensor) -> ScanStructure | None:
    """Return the structure of a scan; None for fewer than `MIN_TRAIT_POINTS` measured points."""
    grid = direction_grid(scan, sensor)
    places = sample_places(len(scan), MAX_POINTS)
    places = places[grid.cell_of_point[places] < NO_CELL]
    count = len(places)
    if count < MIN_TRAIT_POINTS:
        return None
    cells = grid.cell_of_point[places]
    ranges = grid.point_range[places]
    is_hidden = np.empty(count, np.bool_)
    is_in_air = np.empty(count, np.bool_)
    deviations = np.empty(count)
    compare_with_neighbours(grid.nearest, cells, ranges, is_hidden, is_in_air, deviations)
    hidden = places[is_hidden]
    hidden_count = len(hidden) - count_further_returns(
        scan.points, np.asarray(sensor.origin, np.float64), hidden
    )
    return ScanStructure(
        hidden=hidden_count / count,
        in_air=float(is_in_air.mean()),
        roughness=_roughness(deviations),
    )


def _roughness(deviations: Double) -> float:
    """Return the median of the deviations (M,) that are known, 0 if they are too few."""
    measured = deviations[deviations >= 0]
    return float(np.median(measured)) if len(measured) >= MIN_TRAIT_POINTS else 0.0


@compiled
def compare_with_neighbours(
    nearest: Float, cells: Int, ranges: Float, is_hidden: Mask, is_in_air: Mask, deviations: Double
) -> None:
    """Compare each of M points of a sample with its neighbours in the grid of directions.

    Parameters
    ----------
    nearest : (ROWS, COLUMNS) float32
        Nearest ranges, as in a `DirectionGrid`.
    cells : (M,) int32
        Cell of each point.
    ranges : (M,) float32
        Its range in metres.
    is_hidden : (M,) bool
        Result: whether it is one of the hidden points that a `ScanStructure` counts.
    is_in_air : (M,) bool
        Result: whether it is one of the points in the air that a `ScanStructure` counts.
    deviations : (M,) float64
        Relative deviation of the nearest range of its cell from the mean of the cells to the left
        and right; -1 without both.
    """
    for i in range(len(cells)):
        row = cells[i] // COLUMNS
        column = cells[i] % COLUMNS
        centre = nearest[row, column]
        surface_count = 0
        surface = np.float32(0)
        around_count = 0
        front = np.float32(np.inf)
        for v in range(max(row - 1, 0), min(row + 2, ROWS)):
            for step in range(-2, 3):
                other = nearest[v, (column + step) % COLUMNS]
                if other == np.inf:
                    continue
                if abs(step) < 2:
                    surface_count += 1
                    surface = max(surface, other)
                if v != row or step != 0:
                    around_count += 1
                    front = min(front, other)
        least_behind = max(HIDDEN_M, HIDDEN_SHARE * surface)
        is_behind = ranges[i] - surface > least_behind
        is_hidden[i] = is_behind and surface_count >= MIN_SURROUNDING
        least_ahead = max(IN_AIR_M, IN_AIR_SHARE * centre)
        is_ahead = front - centre > least_ahead
        is_in_air[i] = is_ahead and around_count >= MIN_AROUND and centre < NEAR_M
        left = nearest[row, (column - 1) % COLUMNS]
        right = nearest[row, (column + 1) % COLUMNS]
        if left < np.inf and right < np.inf:
            deviations[i] = abs(centre - (left + right) / 2) / centre
        else:
            deviations[i] = -1.0
