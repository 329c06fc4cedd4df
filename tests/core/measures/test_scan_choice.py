# SPDX-License-Identifier: MIT
import math
import statistics

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from salsanext_cli.core.measures.scan_choice import choose_scans, standardised


def pool(scans: int, seed: int, features: int = 5) -> tuple[np.ndarray, np.ndarray]:
    """Return clustered features of very different scales, and weights."""
    random = np.random.default_rng(seed)
    centres = random.normal(size=(max(1, scans // 4), features))
    points = centres[random.integers(0, len(centres), scans)]
    points = points + 0.1 * random.normal(size=points.shape)
    return points * 10.0 ** np.arange(features), random.random(scans)


def order(*arguments) -> list[int]:
    return [choice.scan for choice in choose_scans(*arguments)]


def distance_table(features: np.ndarray) -> list[list[float]]:
    """Return all distances in plain numbers: RMS over features in standard deviations, by √2."""
    columns = [[float(v) for v in column] for column in features.T]
    deviations = [statistics.stdev(column) for column in columns]
    return [
        [
            math.sqrt(
                statistics.fmean(
                    ((column[a] - column[b]) / deviation) ** 2 / 2
                    for column, deviation in zip(columns, deviations, strict=True)
                )
            )
            for b in range(len(features))
        ]
        for a in range(len(features))
    ]


def slow(features: np.ndarray, weights: np.ndarray, count: int) -> list[int]:
    """Choose by plain loops over all pairs."""
    table = distance_table(features)
    scans = range(len(features))
    # The nearest to the mean has the least mean square of distances.
    typical = min(scans, key=lambda a: sum(d * d for d in table[a]))
    diverse, least = [typical], math.inf
    while len(diverse) < count:
        least, farthest = max((min(table[a][b] for b in diverse), a) for a in scans)
        diverse.append(farthest)
    chosen = [max(scans, key=lambda a: weights[a])]
    while len(chosen) < count:
        apart = {a: min(table[a][b] for b in chosen) for a in scans if a not in chosen}
        enough = [a for a in apart if apart[a] >= least / 2]
        chosen.append(max(enough, key=lambda a: weights[a] * apart[a]))
    return chosen


@pytest.mark.parametrize(("scans", "count"), [(2, 2), (9, 4), (30, 10), (30, 30)])
def test_the_choice_is_that_of_a_slow_clear_loop(scans, count):
    features, weights = pool(scans, seed=scans + count)
    assert order(features, weights, count) == slow(features, weights, count)


def test_a_choice_has_rank_distance_and_nearest_scan_also_of_all_or_equal_ones():
    features, weights = np.array([[0.0], [1], [4]]), [0.1, 0.3, 0.2]
    first, second, third = choose_scans(features, weights, 3)
    assert (first.scan, first.uncertainty, first.uncertainty_rank) == (1, 0.3, 1)
    assert math.isnan(first.distance)
    assert first.nearest is None
    assert (second.scan, second.uncertainty_rank, second.nearest) == (2, 2, 1)
    assert second.distance == pytest.approx(3 * third.distance)
    assert (third.scan, third.nearest) == (0, 1)
    features, weights = pool(6, seed=3)
    assert sorted(order(features, weights, 6)) == list(range(6))
    assert order(features, weights, 99) == order(features, weights, 6)
    found = order(np.ones((5, 4)), [1, 3, 2, 3, 0], 5)
    assert found == [1, 3, 2, 0, 4]


@given(
    st.lists(st.tuples(st.integers(0, 2), st.integers(0, 2)), min_size=1, max_size=12),
    st.integers(1, 15),
    st.data(),
)
def test_every_scan_once_and_equal_ones_last(points, count, data):
    doubt = st.lists(st.integers(0, 3), min_size=len(points), max_size=len(points))
    found = choose_scans(np.array(points, float), data.draw(doubt), count)
    chosen = [choice.scan for choice in found]
    assert len(set(chosen)) == len(chosen) == min(count, len(points))
    distinct = len({points[scan] for scan in chosen})
    assert distinct == min(count, len(set(points)))
    # A distance of 0 begins when nothing new is left.
    assert [choice.distance != 0 for choice in found] == [i < distinct for i in range(len(found))]


def test_labelled_scans_count_as_chosen_and_are_not_chosen_again():
    features = np.random.default_rng(3).normal(size=(12, 4))
    uncertainty = np.random.default_rng(4).uniform(1, 2, 12)
    first = [each.scan for each in choose_scans(features, uncertainty, 4)]
    more = choose_scans(features, uncertainty, 4, labelled=first)
    assert len({each.scan for each in more} - {*first}) == 4
    apart = np.linalg.norm(standardised(features)[more[0].scan] - standardised(features), axis=1)
    assert more[0].distance == pytest.approx(apart[first].min())
    assert more[0].nearest in first
    assert len(choose_scans(features, uncertainty, 20, labelled=first)) == 8
