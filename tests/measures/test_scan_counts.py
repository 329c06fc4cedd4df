# SPDX-License-Identifier: MIT
import numpy as np
import pytest

from salsanext_cli.measures.scan_counts import ring_of_point


@pytest.mark.parametrize(
    ("distance", "ring"),
    [(0.01, 0), (9.999, 0), (10, 1), (20, 2), (30, 3), (40, 4), (49.99, 4), (50, 5), (1e5, 5)],
)
def test_a_ring_begins_where_the_previous_one_ends(distance, ring):
    assert ring_of_point(np.array([[0, -distance, 0]], np.float32)) == ring


@pytest.mark.parametrize("point", [(0, 0, 0), (np.nan, 1, 1), (1, np.inf, 1)], ids=str)
def test_points_without_a_measurement_are_in_no_ring(point):
    assert ring_of_point(np.array([point, (6, 8, 1)], np.float32)).tolist() == [-1, 1]
