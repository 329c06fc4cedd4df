# SPDX-License-Identifier: MIT
"""Scans have arrays of their shapes and types, and intensities have one scale."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from salsanext_cli.core.records import Scan, normalised_intensity

POINTS = np.zeros((5, 3), np.float32)
INTENSITY = np.zeros(5, np.float32)
WRONG = (
    (POINTS.astype(float), INTENSITY),
    (POINTS[:, :2], INTENSITY),
    (POINTS.reshape(-1), INTENSITY),
    (POINTS, INTENSITY.astype(float)),
    (POINTS, INTENSITY[:4]),
    (POINTS, INTENSITY[:, None]),
)


@pytest.mark.parametrize("number", range(len(WRONG)))
def test_arrays_of_another_shape_or_type_are_refused(number):
    with pytest.raises(ValueError, match="float32"):
        Scan(*WRONG[number])


@given(st.lists(st.integers(0, 4), max_size=9))
def test_points_are_taken_in_the_order_of_their_indices(index):
    numbers = np.arange(15, dtype=np.float32).reshape(5, 3)
    scan = Scan(numbers, numbers[:, 0]).take(np.array(index, np.intp))
    assert len(scan) == len(index)
    np.testing.assert_array_equal(scan.points[:, 0], scan.intensity)
    assert scan.intensity.tolist() == [3.0 * number for number in index]


@given(arrays.arrays(np.uint8, 8))
def test_bytes_are_divided_by_their_largest_value(values):
    normalised = normalised_intensity(values, 7.0)
    np.testing.assert_allclose(normalised, values / 255, rtol=1e-6)


@pytest.mark.parametrize("kind", [np.float32, np.float64, np.uint16])
def test_other_numbers_are_divided_by_the_scale(kind):
    normalised = normalised_intensity(np.array([0, 50, 100], kind), 100.0)
    assert normalised.dtype == np.float32
    np.testing.assert_allclose(normalised, [0, 0.5, 1])
