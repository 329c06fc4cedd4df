# SPDX-License-Identifier: MIT
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from salsanext_cli.measures.histograms import uncertainty_histogram
from salsanext_cli.measures.kept_points import kept_points

LEVELS = (0.0, 2.0**-49, 0.01, 0.1, 0.101, 0.21, 0.5, 0.999, 1.0)
"""Uncertainties of different bins, but for the first two, which are tied."""
POINTS = st.lists(st.tuples(st.sampled_from(LEVELS), st.booleans()), min_size=1, max_size=60)


def kept_of(values, wrong, kind="error"):
    values, wrong = np.asarray(values, np.float32), np.asarray(wrong, bool)
    group = np.arange(len(values)) % 3
    return kept_points(kind, uncertainty_histogram(values, wrong, group, 3))


@given(POINTS)
def test_threshold_is_that_of_a_slow_loop(points):
    values, wrong = (np.array(column) for column in zip(*points, strict=True))
    values[values == LEVELS[1]] = 0
    found = kept_of(values, wrong)
    assert found.points == len(points)
    assert found.risk_of_all == wrong.mean()
    coverages = [(values <= level).mean() for level in sorted(set(values))[:-1]]
    if wrong.all() or not wrong.any() or not coverages:
        assert math.isnan(found.threshold)
        assert math.isnan(found.coverage)
        return
    assert abs(found.coverage - 0.8) == pytest.approx(min(abs(c - 0.8) for c in coverages))
    kept = values.astype(np.float32) < found.threshold
    assert found.coverage == pytest.approx(kept.mean())
    assert found.risk == pytest.approx(wrong[kept].mean())
    assert found.threshold == float(f"{found.threshold:.4g}")


@pytest.mark.parametrize(
    ("values", "wrong", "says"),
    [
        ([0.1, 0.9], [0, 0], "no threshold of error is needed: none of the 2 points is wrong"),
        ([0.1, 0.9], [1, 1], "no threshold of error helps: all 2 points are wrong"),
        ([0.3] * 4, [0, 1, 0, 1], "no threshold of error helps: it is the same at all 4 points"),
        (
            [0.1, 0.2, 0.3, 0.4],
            [1, 1, 0, 0],
            "error does not find wrong points: of the 75 % of points with error below 0.35 "
            "66.7 % are wrong, of all 50.0 %",
        ),
    ],
)
def test_where_no_threshold_helps_the_sentence_says_so(values, wrong, says):
    assert kept_of(values, wrong).sentence == says
