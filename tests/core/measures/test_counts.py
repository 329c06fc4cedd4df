# SPDX-License-Identifier: MIT
"""Counts of points by class, label and distance."""

import numpy as np
import pytest

from salsanext_cli.core.measures.counts import band_of_point


@pytest.mark.parametrize(
    ("distance", "band"),
    [(0.01, 0), (9.999, 0), (10, 1), (20, 2), (30, 3), (40, 4), (49.99, 4), (50, 5), (1e5, 5)],
)
def test_a_distance_band_begins_where_the_previous_one_ends(distance, band):
    assert band_of_point(np.array([[0, -distance, 0]], np.float32)) == band
