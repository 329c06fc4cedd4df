# SPDX-License-Identifier: MIT
"""Measures of a scan are those of slow loops over its points and pixels."""

import math
from statistics import median

import numpy as np
import pytest
from scans import SMALL

from salsanext_cli import Scan
from salsanext_cli.core.geometry.projection import project
from salsanext_cli.core.geometry.scan_measures import MEASURES, compared_measures, measures_of


def scan_of(turn, count=3000, intensities=20):
    """Return points in all rows and in a part of the circle, 0…1."""
    rng = np.random.default_rng(1)
    azimuth = rng.uniform(-math.pi, math.pi * (2 * turn - 1), count)
    elevation = np.radians(rng.uniform(SMALL.fov_down, SMALL.fov_up, count))
    ranges = rng.uniform(3, 50, count)
    flat = ranges * np.cos(elevation)
    points = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), ranges * np.sin(elevation)])
    intensity = rng.integers(1, intensities + 1, count) / intensities
    return Scan(points.T.astype(np.float32), intensity.astype(np.float32))


def measured(scan):
    values = measures_of(scan, project(scan, SMALL), SMALL)
    return dict(zip([measure.name for measure in MEASURES], values, strict=True))


@pytest.mark.parametrize("turn", [1.0, 0.25])
def test_measures_are_those_of_slow_loops(turn):
    scan = scan_of(turn)
    values, (ranges, *_, intensity) = measured(scan), project(scan, SMALL).channels
    rows, columns = ranges.shape
    pairs = [
        abs(intensity[v, u] - intensity[v, u + 1])
        for v in range(rows)
        for u in range(columns - 1)
        if ranges[v, u] and ranges[v, u + 1]
    ]
    usual = median(float(i) for i, r in zip(intensity.flat, ranges.flat, strict=True) if r)
    noise = [
        abs(ranges[v, u - 1] - 2 * ranges[v, u] + ranges[v, u + 1]) / ranges[v, u]
        for v in range(rows // 2, rows)
        for u in range(1, columns - 1)
        if ranges[v, u - 1] and ranges[v, u] and ranges[v, u + 1]
    ]
    lengths = [math.dist(point, (0, 0, 0)) for point in scan.points.tolist()]
    expected = {
        "points of a scan": 3000,
        "share of the columns with points": sum(map(any, ranges.T)) / columns,
        "share of the pixels with points": np.count_nonzero(ranges) / ranges.size,
        "median range": median(lengths),
        "median intensity": median(scan.intensity.tolist()),
        "number of different intensities": 20,
        "relative change of intensity between columns": median(pairs) / usual,
        "relative noise of ranges": median(noise),
    }
    assert {name: values[name] for name in expected} == pytest.approx(expected, abs=1e-3, rel=1e-3)
    assert values["share of the columns with points"] == pytest.approx(turn, abs=0.05)
    assert values["lowest elevation"] >= SMALL.fov_down
    assert values["highest elevation"] <= SMALL.fov_up


def test_a_scan_without_intensity_or_points_has_measures():
    scan = scan_of(1.0)
    dark = Scan(scan.points, np.zeros(len(scan), np.float32))
    empty = Scan(np.zeros((5, 3), np.float32), np.zeros(5, np.float32))
    for of_scan in (dark, empty):
        values = np.array([*measured(of_scan).values()])
        assert np.isfinite(compared_measures(values[None])).all()
    assert measured(dark)["upper intensity"] == 0


def test_ratios_are_compared_where_a_measure_is_logarithmic():
    values = np.full((2, len(MEASURES)), 0.5)
    values[1] *= 2
    gaps = np.diff(compared_measures(values), axis=0)[0]
    expected = [math.log(2) if measure.is_logarithmic else 0.5 for measure in MEASURES]
    np.testing.assert_allclose(gaps, expected)
