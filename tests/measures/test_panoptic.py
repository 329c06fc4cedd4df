# SPDX-License-Identifier: MIT
"""Panoptic quality, compared with a slow loop over all pairs of segments."""

import numpy as np
import pytest
from evaluated import small_space
from hypothesis import given
from hypothesis import strategies as st

from salsanext_cli.measures.panoptic import MIN_SEGMENT_POINTS, count_segments, panoptic_quality

SPACE = small_space("none", "road", "car", "person")
THINGS = np.array([False, False, True, True])


def slow_counts(truth, predicted):
    """Take the definition word by word: labels are pairs of class and instance."""
    points = [(t, p) for t, p in zip(truth, predicted, strict=True) if t[0] != 0]
    counts = np.zeros((4, 5))
    for c in (1, 2, 3):
        true = {t for t, _ in points if t[0] == c}
        found = {p for _, p in points if p[0] == c}
        matched = set()
        for t in true:
            for p in found:
                both = sum(pair == (t, p) for pair in points)
                either = sum(pair[0] == t or pair[1] == p for pair in points)
                if both / either > 0.5:
                    counts[c, :2] += both / either, 1
                    matched |= {("t", t), ("p", p)}
        size = {("t", t): sum(pair[0] == t for pair in points) for t in true}
        size |= {("p", p): sum(pair[1] == p for pair in points) for p in found}
        alone = [key for key, n in size.items() if key not in matched and n >= MIN_SEGMENT_POINTS]
        counts[c, 2:4] = sum(key[0] == "p" for key in alone), sum(key[0] == "t" for key in alone)
        counts[c, 4] = sum(instance > 0 for _, instance in true)
    return counts


def counts_of(truth, predicted):
    both = []
    for labels in (truth, predicted):
        train, instance = np.array(labels, np.int64).reshape(-1, 2).T
        both.append((train.astype(np.uint8), (train | instance << 16).astype(np.uint32)))
    return count_segments(*both, SPACE.scored)


@given(
    st.lists(
        st.tuples(*[st.tuples(st.integers(0, 3), st.integers(0, 2))] * 2, st.integers(1, 90)),
        max_size=9,
    )
)
def test_counts_are_those_of_the_definition(blocks):
    truth = [t for t, _, count in blocks for _ in range(count)]
    predicted = [p for _, p, count in blocks for _ in range(count)]
    np.testing.assert_allclose(counts_of(truth, predicted), slow_counts(truth, predicted))


def test_qualities_of_counts():
    """Three of four points of a car, all of a road, and a person that is called a car."""
    truth = [(2, 7)] * 100 + [(1, 0)] * 100 + [(3, 1)] * 60
    predicted = [(2, 1)] * 75 + [(1, 0)] * 125 + [(2, 2)] * 60
    found = panoptic_quality(counts_of(truth, predicted), SPACE, THINGS)
    car = found["classes"]["car"]
    assert car == {
        "pq": 0.5,
        "sq": 0.75,
        "rq": pytest.approx(2 / 3),
        "matches": 1,
        "false_alarms": 1,
        "misses": 0,
    }
    assert found["classes"]["road"]["pq"] == pytest.approx(0.8)
    assert found["classes"]["person"]["misses"] == 1
    assert found["things"]["pq"] == pytest.approx(0.25)
    assert found["all"]["pq"] == pytest.approx((0.5 + 0.8) / 3)
    assert panoptic_quality(counts_of([], []), SPACE, THINGS)["all"] == {"pq": 0, "sq": 0, "rq": 0}
