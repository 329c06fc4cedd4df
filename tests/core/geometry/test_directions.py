# SPDX-License-Identifier: MIT
"""Directions of the points of a scan from its sensor."""

from dataclasses import replace

import numpy as np
import pytest
from scans import SMALL
from street_scans import moved, street

from salsanext_cli import Scan
from salsanext_cli.core.geometry.directions import NO_CELL, direction_grid


@pytest.mark.parametrize("origin", [(0.0, 0.0, 0.0), (30.0, -20.0, 2.0)])
def test_points_without_a_measurement_have_no_direction(origin):
    """They are zeros in the file, wherever the sensor is."""
    points = np.array([[0, 0, 0], [35, -20, 2], [np.nan, 0, 0], [0, 0, 5]], np.float32)
    grid = direction_grid(Scan(points, np.ones(4, np.float32)), replace(SMALL, origin=origin))
    assert (grid.cell_of_point < NO_CELL).tolist() == [False, True, False, True]


def test_zeros_do_not_change_the_nearest_ranges():
    place = (30.0, -20.0, 2.0)
    scan, sensor = moved(street(32), place), replace(SMALL, origin=place)
    empty = np.zeros((5000, 3), np.float32)
    points = np.concatenate([empty, scan.points])
    padded = Scan(points, np.ones(len(points), np.float32))
    assert np.array_equal(
        direction_grid(padded, sensor).nearest, direction_grid(scan, sensor).nearest
    )
