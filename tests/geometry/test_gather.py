# SPDX-License-Identifier: MIT
"""Values of pixels and points: against loops, on drawn images and on a projection."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from salsanext_cli.geometry.projection import pixels_from_points, points_from_pixels

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
