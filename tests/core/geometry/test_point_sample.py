# SPDX-License-Identifier: MIT
"""Ranges are distances of measured points; a sample of points is the same in every run."""

import math

import numpy as np
import pytest
from scans import make_scan

from salsanext_cli.core.geometry.point_sample import few_points, measured_ranges, sample_places


def test_ranges_equal_a_loop():
    points = np.array(
        [[3, 4, 0], [0, 0, 0], [np.nan, 1, 1], [np.inf, 0, 0], [1, 2, 2], [0, 0, 60]], np.float32
    )
    ranges, is_measured = measured_ranges(points, farthest=50.0)
    for point, distance, measured in zip(points.tolist(), ranges, is_measured, strict=True):
        expected = math.hypot(*point)
        assert distance == pytest.approx(expected, nan_ok=True)
        assert measured == (math.isfinite(expected) and 0 < expected <= 50)


def test_a_sample_is_sorted_spread_and_always_the_same():
    places = sample_places(100_000, 1000)
    assert np.array_equal(places, sample_places(100_000, 1000))
    assert np.array_equal(places, np.sort(places))
    assert places[0] >= 0
    assert places[-1] < 100_000
    tenths = np.bincount(places // 10_000, minlength=10)
    assert tenths.min() > 60, "a tenth of the points has about a tenth of the sample"
    assert len(set(np.diff(places).tolist())) > 50, "not every n-th point"


def test_few_points_are_all_of_them():
    scan = make_scan()
    assert few_points(scan, len(scan)) is scan
    assert sample_places(7, 10).tolist() == list(range(7))
    few = few_points(scan, 20)
    assert np.array_equal(few.points, scan.points[sample_places(len(scan), 20)])
