# SPDX-License-Identifier: MIT
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from salsanext_cli.measures.confusion import Confusion
from salsanext_cli.measures.distance import RING_NAMES, confusion_by_ring, ring_of_point


@pytest.mark.parametrize(
    ("distance", "ring"),
    [(0.01, 0), (9.999, 0), (10, 1), (20, 2), (30, 3), (40, 4), (49.99, 4), (50, 5), (1e5, 5)],
)
def test_a_ring_begins_where_the_one_before_ends(distance, ring):
    assert ring_of_point(np.array([[0, -distance, 0]], np.float32)) == ring


@pytest.mark.parametrize("point", [(0, 0, 0), (np.nan, 1, 1), (1, np.inf, 1)], ids=str)
def test_points_without_a_measurement_are_in_no_ring(point):
    points = np.array([point, (6, 8, 1)], np.float32)
    assert ring_of_point(points).tolist() == [-1, 1]
    rings = confusion_by_ring(ring_of_point(points), np.array([1, 2]), np.array([1, 1]), 3)
    assert sum(ring.total for ring in rings) == 1
    assert rings[1].matrix[2, 1] == 1


@given(st.lists(st.tuples(*[st.floats(-60, 60, width=32)] * 3), min_size=1, max_size=40))
def test_rings_together_are_the_whole(coordinates):
    points = np.array(coordinates, np.float32)
    measured = np.linalg.norm(points.astype(float), axis=1) > 0
    rng = np.random.default_rng(len(points))
    truth, predicted = rng.integers(0, 4, (2, len(points)))
    rings = confusion_by_ring(ring_of_point(points), truth, predicted, 4)
    assert len(rings) == len(RING_NAMES)
    whole = Confusion(4).update(truth[measured], predicted[measured])
    assert sum(rings, start=Confusion(4)) == whole
