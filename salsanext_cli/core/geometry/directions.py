# SPDX-License-Identifier: MIT
"""Nearest range in each direction, on a grid of equal solid angles for scans of any sensor.

A range image has the rows of its sensor. This grid has cells of 0.4°, so that surfaces of one scan
can be compared with those of another sensor.
"""

import math
from dataclasses import dataclass

import numpy as np

from salsanext_cli.core.compiled import argument, compiled
from salsanext_cli.core.geometry.projection import arctan2
from salsanext_cli.core.geometry.sensor_frame import upright_rotation
from salsanext_cli.core.records import MAX_RANGE_M, Double, Float, Int, Scan
from salsanext_cli.core.sensors.sensor import Sensor

ROWS = 288  # Cells between straight down and straight up, of equal heights on a sphere
COLUMNS = 900  # Cells around
NO_CELL = ROWS * COLUMNS  # Index of the cell of points without a direction
NEAREST_M = 2.0  # Nearer points belong to the vehicle


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class DirectionGrid:
    """Directions of the points of a scan from its sensor.

    Attributes
    ----------
    cell_of_point : (N,) int32
        Flat index ``row * COLUMNS + column`` of each point; `NO_CELL` nearer than `NEAREST_M`,
        and without a measurement.
    point_range : (N,) float32
        Distance of each point from the sensor in metres; undefined without a cell.
    nearest : (ROWS, COLUMNS) float32
        Range of the nearest point of each cell in metres; infinite where empty.
    """

    cell_of_point: Int
    point_range: Float
    nearest: Float


def direction_grid(scan: Scan, sensor: Sensor) -> DirectionGrid:
    """Return the directions of a scan (N points) from the `origin` of a sensor, `up` upwards."""
    count = len(scan)
    cell_of_point = np.empty(count, np.int32)
    point_range = np.empty(count, np.float32)
    nearest = np.full(NO_CELL + 1, np.inf, np.float32)
    points = argument(scan.points, np.float32).reshape(-1)
    origin = np.array(sensor.origin, np.float64)
    rotation = upright_rotation(np.asarray(sensor.up, np.float64))
    find_cells(points, origin, rotation, cell_of_point, point_range)
    keep_nearest_range(cell_of_point, point_range, nearest)
    return DirectionGrid(
        cell_of_point=cell_of_point,
        point_range=point_range,
        nearest=nearest[:NO_CELL].reshape(ROWS, COLUMNS),
    )


@compiled
def find_cells(
    points: Float, origin: Double, rotation: Double, cell_of_point: Int, point_range: Float
) -> None:
    """Write the cell and the range of each point.

    Parameters
    ----------
    points : (3 N,) float32
        Coordinates in the frame of the file, point by point, in metres.
    origin : (3,) float64
        Position of the sensor in this frame, in metres.
    rotation : (3, 3) float64
        Rotation that turns the direction up to z.
    cell_of_point : (N,) int32
        Result: cell of each point, as in a `DirectionGrid`.
    point_range : (N,) float32
        Result: range of each point in metres.
    """
    # Without branches the loop is vectorised.
    for i in range(len(point_range)):
        a = points[3 * i]
        b = points[3 * i + 1]
        c = points[3 * i + 2]
        x = np.float64(a) - origin[0]
        y = np.float64(b) - origin[1]
        z = np.float64(c) - origin[2]
        ahead = rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z
        aside = rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z
        above = rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z
        distance = math.sqrt(ahead * ahead + aside * aside + above * above)
        # Zeros in the file are no measurement, wherever the sensor is.
        stated = (a != 0) | (b != 0) | (c != 0)
        measured = stated & (distance >= NEAREST_M) & (distance <= MAX_RANGE_M)
        column = (arctan2(aside, ahead) / math.pi + 1) * (COLUMNS / 2)
        row = (above / distance + 1) * (ROWS / 2)
        column = column if column < COLUMNS - 1 else COLUMNS - 1.0
        row = row if row < ROWS - 1 else ROWS - 1.0
        cell = np.int32(row) * np.int32(COLUMNS) + np.int32(column)
        cell_of_point[i] = cell if measured else np.int32(NO_CELL)
        point_range[i] = np.float32(distance)


@compiled
def keep_nearest_range(cell_of_point: Int, point_range: Float, nearest: Float) -> None:
    """Lower the range of each cell to that of its nearest point.

    Parameters
    ----------
    cell_of_point : (N,) int32
        Cell of each point, as in a `DirectionGrid`.
    point_range : (N,) float32
        Range of each point in metres.
    nearest : (NO_CELL + 1,) float32
        Range of each cell in metres; the last cell is of points without a direction.
    """
    # Without branches, which the processor cannot predict, this takes a sixth of the time.
    for i in range(len(cell_of_point)):
        cell = cell_of_point[i]
        held = nearest[cell]
        nearest[cell] = point_range[i] if point_range[i] < held else held
