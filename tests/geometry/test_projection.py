# SPDX-License-Identifier: MIT
"""Projection: against the slow loop, closed forms and the published implementation."""

import math

import numba
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from slow_geometry import slow_project

from salsanext_cli import Scan, Sensor, project, sensor
from salsanext_cli.geometry.projection import arctan2

FIELDS = ("channels", "pixel_of_point", "point_of_pixel", "point_range")
WIDE = Sensor("wide", 90, -90, 4, 8)


def scan_of(*points):
    points = np.array(points, np.float32).reshape(-1, 3)
    return Scan(points, np.linspace(0.1, 0.9, len(points), dtype=np.float32))


def assert_same(image, expected):
    for field, values in zip(FIELDS, expected, strict=True):
        assert getattr(image, field).dtype == values.dtype
        np.testing.assert_array_equal(getattr(image, field), values, err_msg=field)


def fields_of(image):
    return [getattr(image, field) for field in FIELDS]


coordinates = st.one_of(
    st.sampled_from([0.0, -0.0, 1.0, -1.0, 2.0, 1e-40, 1e30, -3e38, math.nan, math.inf, -math.inf]),
    st.integers(-4, 4).map(float),
    st.floats(-100, 100, width=32),
)
scans = st.integers(0, 24).flatmap(
    lambda n: st.builds(
        Scan,
        arrays.arrays(np.float32, (n, 3), elements=coordinates),
        arrays.arrays(np.float32, n, elements=coordinates),
    )
)


@st.composite
def sensors(draw):
    down, extent = draw(st.floats(-90, 60)), draw(st.floats(0.01, 120))
    height, width = draw(st.integers(1, 6)), draw(st.integers(1, 9))
    out_of_view = draw(st.sampled_from(["clamp", "drop"]))
    return Sensor("drawn", down + extent, down, height, width, out_of_view=out_of_view)


@given(scans, sensors())
def test_equals_the_slow_loop(scan, drawn):
    assert_same(project(scan, drawn), slow_project(scan, drawn))


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_many_points_on_any_number_of_threads(rings, threads, monkeypatch):
    monkeypatch.setattr("salsanext_cli.compiled.MIN_SLICE_ITEMS", 100)
    monkeypatch.setitem(vars(numba.config), "NUMBA_NUM_THREADS", threads)
    assert_same(project(rings, sensor("hdl64")), slow_project(rings, sensor("hdl64")))


def test_compass():
    """Forward is the middle column, left a quarter before, backward the ends; up is row 0."""
    image = project(scan_of((9, 0, 0), (0, 9, 0), (0, -9, 0), (-9, 1e-6, 0), (-9, -1e-6, 0)), WIDE)
    assert (image.pixel_of_point % 8).tolist() == [4, 2, 6, 0, 7]
    up, down = project(scan_of((0, 0, 5), (0, 0, -5)), WIDE).pixel_of_point // 8
    assert (up, down) == (0, 3)


def test_takes_views_and_read_only_arrays(rings):
    columns = np.column_stack([rings.points, rings.intensity])
    columns.setflags(write=False)
    image = project(Scan(columns[:, :3], columns[:, 3]), WIDE)
    assert_same(image, fields_of(project(rings, WIDE)))


def test_the_arctangent_is_that_of_the_library():
    y, x = np.random.default_rng(5).normal(size=(2, 20_000))
    x[:4], y[:4] = (0, -0.0, 0, 1), (0, 0.0, -1, 0)
    found = np.array([arctan2(*pair) for pair in zip(y, x, strict=True)])
    np.testing.assert_allclose(found, np.arctan2(y, x), rtol=0, atol=1e-11)


@pytest.mark.real
def test_published_projection(real_image, golden):
    with np.load(golden / "projection.npz") as published:
        column, row = real_image.pixel_of_point % 2048, real_image.pixel_of_point // 2048
        assert (column == published["pixel_x"]).mean() >= 0.9999
        assert (row == published["pixel_y"]).mean() >= 0.9999
        assert (real_image.point_of_pixel == published["pixel_to_point"]).mean() >= 0.9999
        np.testing.assert_allclose(real_image.point_range, published["point_range"], rtol=2e-7)
