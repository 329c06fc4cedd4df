# SPDX-License-Identifier: MIT
"""Projection: against slow loops, closed forms and the published implementation."""

import math

import numba
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scans import SMALL

from salsanext_cli import Scan, Sensor, project, sensor
from salsanext_cli.core.geometry.projection import arctan2, pixels_from_points, points_from_pixels

F = np.float32
FIELDS = ("channels", "pixel_of_point", "point_of_pixel", "point_range")


def slow_project(scan, sensor):
    """Project one point after the other; return the four arrays of a `RangeImage`."""
    height, width = sensor.height, sensor.width
    down = F(math.radians(sensor.fov_down))
    extent = F(math.radians(sensor.fov_up) - math.radians(sensor.fov_down))
    channels = np.zeros((5, height, width), np.float32)
    pixel_of_point = np.full(len(scan), -1, np.int32)
    point_of_pixel = np.full((height, width), -1, np.int32)
    point_range = np.zeros(len(scan), np.float32)
    for i in range(len(scan)):
        x, y, z = (float(coordinate) for coordinate in scan.points[i])
        if not all(map(math.isfinite, (x, y, z))):
            continue
        r = F(math.sqrt(x * x + y * y + z * z)) if max(abs(x), abs(y), abs(z)) < 1e7 else F(1e7)
        if r == 0 or r > 1e6:
            continue
        yaw = F(math.atan2(y, x))
        pitch = F(math.asin(float(F(z) / r)))
        u = F(0.5) * (F(1) - yaw / F(math.pi)) * F(width)
        v = (F(1) - (pitch - down) / extent) * F(height)
        if sensor.out_of_view == "drop" and not 0 <= v <= height:
            continue
        column = min(max(math.floor(u), 0), width - 1)
        row = min(max(math.floor(v), 0), height - 1)
        pixel_of_point[i], point_range[i] = row * width + column, r
        holder = point_of_pixel[row, column]
        if holder < 0 or r < point_range[holder]:
            point_of_pixel[row, column] = i
            intensity = scan.intensity[i] if abs(scan.intensity[i]) <= 1e6 else 0
            channels[:, row, column] = r, x, y, z, intensity
    return channels, pixel_of_point, point_of_pixel, point_range


def assert_same(image, expected):
    for field, values in zip(FIELDS, expected, strict=True):
        assert getattr(image, field).dtype == values.dtype
        np.testing.assert_array_equal(getattr(image, field), values, err_msg=field)


SPECIAL = np.float32([0, -0.0, 1, -1, 2, 1e-40, 1e30, -3e38, math.nan, math.inf, -math.inf])
coordinates = st.one_of(
    st.sampled_from(SPECIAL.tolist()), st.integers(-4, 4).map(float), st.floats(-100, 100, width=32)
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


@pytest.mark.usefixtures("small_slices")
@pytest.mark.parametrize("threads", [1, 2, 5])
def test_many_points_on_any_number_of_threads(rings, threads, monkeypatch):
    monkeypatch.setitem(vars(numba.config), "NUMBA_NUM_THREADS", threads)
    assert_same(project(rings, sensor("hdl64")), slow_project(rings, sensor("hdl64")))


def test_takes_views_and_read_only_arrays(rings):
    columns = np.column_stack([rings.points, rings.intensity])
    columns.setflags(write=False)
    image, expected = project(Scan(columns[:, :3], columns[:, 3]), SMALL), project(rings, SMALL)
    assert_same(image, [getattr(expected, field) for field in FIELDS])


def test_the_arctangent_equals_the_library():
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


DTYPES = st.sampled_from([np.float32, np.float16, np.uint8])


@given(st.data(), DTYPES, st.lists(st.integers(-1, 11), max_size=9))
def test_points_from_pixels_equals_a_loop(data, dtype, pixel_of_point):
    shape = data.draw(st.sampled_from([(3, 4), (2, 3, 4), (1, 3, 4)]))
    image = data.draw(arrays.arrays(dtype, shape, elements={"allow_nan": False}))
    empty = np.arange(shape[0]) + 5 if len(shape) == 3 else 7
    indices = np.array(pixel_of_point, np.int32)
    found = points_from_pixels(image, indices, empty)
    assert found.dtype == dtype
    assert found.shape == (len(indices), *shape[:-2])
    for values, pixel in zip(found, pixel_of_point, strict=True):
        expected = empty if pixel < 0 else image[..., pixel // 4, pixel % 4]
        np.testing.assert_array_equal(values, expected)


@given(st.data(), DTYPES, st.integers(0, 5))
def test_pixels_from_points_equals_a_loop(data, dtype, count):
    values = data.draw(arrays.arrays(dtype, count, elements={"allow_nan": False}))
    indices = data.draw(arrays.arrays(np.int32, (2, 3), elements=st.integers(-1, count - 1)))
    found = pixels_from_points(values, indices, 9)
    assert found.dtype == dtype
    expected = [[9 if i < 0 else values[i] for i in row] for row in indices.tolist()]
    np.testing.assert_array_equal(found, np.array(expected, dtype))
    pairs = pixels_from_points(np.stack([values, values], axis=1), indices, (9, 8))
    np.testing.assert_array_equal(pairs[..., 0], found)
    assert (pairs[indices < 0] == (9, 8)).all()
