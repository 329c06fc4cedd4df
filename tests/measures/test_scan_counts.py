# SPDX-License-Identifier: MIT
import numpy as np
import pytest

from salsanext_cli import label_space
from salsanext_cli.measures.scan_counts import ScanCounts, band_of_point


@pytest.mark.parametrize(
    ("distance", "band"),
    [(0.01, 0), (9.999, 0), (10, 1), (20, 2), (30, 3), (40, 4), (49.99, 4), (50, 5), (1e5, 5)],
)
def test_a_distance_band_begins_where_the_previous_one_ends(distance, band):
    assert band_of_point(np.array([[0, -distance, 0]], np.float32)) == band


@pytest.mark.parametrize(
    ("right", "wrong", "said"), [(300, 9800, "3.0%"), (2100, 8000, ""), (1, 900, "")]
)
def test_labels_that_hardly_ever_agree_are_doubted(right, wrong, said):
    counts = ScanCounts.none(label_space(), by_distance=False)
    counts.confusion.matrix[[1, 9, 0], [1, 0, 5]] = right, wrong, 100_000
    warnings = [*counts.label_warnings(label_space())]
    assert len(warnings) == bool(said)
    assert all(said in text and "--label-space" in text for text in warnings)
