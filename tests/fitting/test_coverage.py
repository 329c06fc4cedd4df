# SPDX-License-Identifier: MIT
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scans import SMALL, make_scan

from salsanext_cli import Scan, project
from salsanext_cli.fitting.scan_checks import FieldOfViewCoverage, field_of_view_coverage
from salsanext_cli.geometry.ranges import measured_ranges

DROPPING = replace(SMALL, out_of_view="drop")


def at(elevations, distance=20.0):
    """Return points at elevations in degrees."""
    angle = np.radians(np.asarray(elevations, np.float64))
    points = np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=1) * distance
    return Scan(points.astype(np.float32), np.zeros(len(points), np.float32))


def test_ranges_and_which_of_them_are_measurements():
    values = np.array([[3, 4, 0], [0, 0, 0], [1, 1, 1], [0, 0, 0], [3e38, 0, 0]], np.float32)
    values.view(np.uint32)[1, 2] = 0x7F800001  # a NaN that signals
    values[2, 0] = -np.inf
    ranges, measured = measured_ranges(values)
    assert measured.tolist() == [True, False, False, False, True]
    assert ranges[measured].tolist() == [5, values[4, 0]]
    assert measured_ranges(values, 5.0)[1].tolist() == [True, False, False, False, False]


@given(st.lists(st.floats(-90, 90).filter(lambda e: min(abs(e - 3), abs(e + 25)) > 0.01)))
def test_points_are_counted_one_by_one(elevations):
    outside = sum(not -25 <= elevation <= 3 for elevation in elevations)
    expected = FieldOfViewCoverage(len(elevations), outside)
    assert (
        field_of_view_coverage(at(elevations), SMALL)
        == field_of_view_coverage(at(elevations), DROPPING)
        == expected
    )


def test_outside_is_what_a_sensor_would_drop():
    scan = make_scan(4000)
    narrow = replace(DROPPING, fov_up=0.0, fov_down=-12.0)
    dropped = int((project(scan, narrow).pixel_of_point < 0).sum())
    assert 500 < dropped < 3500
    assert field_of_view_coverage(scan, narrow) == FieldOfViewCoverage(4000, dropped)


def test_points_without_a_measurement_do_not_count():
    points = [[0, 0, 0], [math.nan, 1, 1], [math.inf, 0, 0], [0, 0, -math.inf], [1e7, 0, 0]]
    scan = Scan(np.array([*points, [1, 0, 5]], np.float32), np.zeros(6, np.float32))
    level = replace(SMALL, fov_up=0.0)
    assert field_of_view_coverage(scan, level) == FieldOfViewCoverage(1, 1)
    assert field_of_view_coverage(at([]), SMALL).share == 0
    assert (FieldOfViewCoverage(6, 1) + FieldOfViewCoverage(4, 2)).share == pytest.approx(0.3)
