# SPDX-License-Identifier: MIT
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scans import SMALL

from salsanext_cli import Scan
from salsanext_cli.fitting.scan_checks import FieldOfViewCoverage, field_of_view_coverage

DROPPING = replace(SMALL, out_of_view="drop")


def at(elevations, distance=20.0):
    """Return points at elevations in degrees."""
    angle = np.radians(np.asarray(elevations, np.float64))
    points = np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=1) * distance
    return Scan(points.astype(np.float32), np.zeros(len(points), np.float32))


@given(st.lists(st.floats(-90, 90).filter(lambda e: min(abs(e - 3), abs(e + 25)) > 0.01)))
def test_points_are_counted_one_by_one(elevations):
    outside = sum(not -25 <= elevation <= 3 for elevation in elevations)
    expected = FieldOfViewCoverage(len(elevations), outside)
    assert (
        field_of_view_coverage(at(elevations), SMALL)
        == field_of_view_coverage(at(elevations), DROPPING)
        == expected
    )


def test_points_without_a_measurement_do_not_count():
    points = [[0, 0, 0], [math.nan, 1, 1], [math.inf, 0, 0], [0, 0, -math.inf], [1e7, 0, 0]]
    scan = Scan(np.array([*points, [1, 0, 5]], np.float32), np.zeros(6, np.float32))
    level = replace(SMALL, fov_up=0.0)
    assert field_of_view_coverage(scan, level) == FieldOfViewCoverage(1, 1)
    assert field_of_view_coverage(at([]), SMALL).share == 0
    assert (FieldOfViewCoverage(6, 1) + FieldOfViewCoverage(4, 2)).share == pytest.approx(0.3)
