# SPDX-License-Identifier: MIT
"""Structure of a scan that shows several scans in one, noise, fog and snow, without labels.

A single sensor sees the nearest surface in each direction. Its neighbouring ranges differ little,
and few of its points lie alone in front of everything around.
"""

from dataclasses import dataclass

import numpy as np

from salsanext_cli.compiled import compiled
from salsanext_cli.geometry.directions import COLUMNS, NO_CELL, ROWS, direction_grid
from salsanext_cli.geometry.projection import sample_places
from salsanext_cli.geometry.scan_traits import MIN_TRAIT_POINTS
from salsanext_cli.records import Double, Float, Int, Scan
from salsanext_cli.sensors.sensor import Sensor

MAX_POINTS = 8192  # Points in a sample of a scan
MIN_SURROUNDING = 5  # Fewest occupied cells, of 3 × 3, that show the surface around a point
HIDDEN_M, HIDDEN_SHARE = 1.0, 0.05
"""Least distance of a hidden point behind that surface, in metres and of its range."""
MIN_AROUND = 4  # Fewest other occupied cells, of 3 × 5, around a point in the air
IN_AIR_M, IN_AIR_SHARE = 0.5, 0.05
"""Least distance of a point in the air in front of them, in metres and of its range."""
NEAR_M = 15.0  # Largest range of a point in the air


@dataclass(frozen=True, slots=True)
class ScanStructure:
    """Structure of the measured points of a scan, estimated from a sample."""

    hidden: float  # Share, 0…1, of the points behind all surfaces around their direction
    in_air: float  # Share, 0…1, of the points near the sensor and in front of all around
    roughness: float  # Median deviation of a range from the mean of its two neighbours, relative


def structure_of(scan: Scan, sensor: Sensor) -> ScanStructure | None:
    """Return the structure of a scan; None for fewer than `MIN_TRAIT_POINTS` measured points."""
    grid = direction_grid(scan, sensor)
    places = sample_places(len(scan), MAX_POINTS)
    cells = grid.cell_of_point[places]
    measured = cells < NO_CELL
    cells, ranges = cells[measured], grid.point_range[places][measured]
    if len(cells) < MIN_TRAIT_POINTS:
        return None
    deviations = np.empty(len(cells))
    hidden, in_air = compare_with_neighbours(grid.nearest, cells, ranges, deviations)
    deviations = deviations[deviations >= 0]
    roughness = float(np.median(deviations)) if len(deviations) >= MIN_TRAIT_POINTS else 0.0
    return ScanStructure(hidden / len(cells), in_air / len(cells), roughness)


@compiled
def compare_with_neighbours(
    nearest: Float, cells: Int, ranges: Float, deviations: Double
) -> tuple[int, int]:
    """Count points (M,) of `ScanStructure`: hidden ones, and ones in the air.

    `nearest` is that of the `DirectionGrid`. The relative deviation of the nearest range of the
    cell of each point from the mean of the cells to its left and right is written, -1 without
    both.
    """
    hidden, in_air = 0, 0
    for i in range(len(cells)):
        row, column = cells[i] // COLUMNS, cells[i] % COLUMNS
        centre = nearest[row, column]
        surrounding, surface = 0, np.float32(0)
        around, front = 0, np.float32(np.inf)
        for v in range(max(row - 1, 0), min(row + 2, ROWS)):
            for step in range(-2, 3):
                other = nearest[v, (column + step) % COLUMNS]
                if other == np.inf:
                    continue
                if abs(step) < 2:
                    surrounding += 1
                    surface = max(surface, other)
                if v != row or step != 0:
                    around += 1
                    front = min(front, other)
        behind = max(HIDDEN_M, HIDDEN_SHARE * surface)
        hidden += surrounding >= MIN_SURROUNDING and ranges[i] - surface > behind
        ahead = max(IN_AIR_M, IN_AIR_SHARE * centre)
        in_air += around >= MIN_AROUND and centre < NEAR_M and front - centre > ahead
        left, right = nearest[row, (column - 1) % COLUMNS], nearest[row, (column + 1) % COLUMNS]
        both = left < np.inf and right < np.inf
        deviations[i] = abs(centre - (left + right) / 2) / centre if both else -1.0
    return hidden, in_air
