# SPDX-License-Identifier: MIT
import math
from fractions import Fraction
from functools import reduce
from itertools import chain
from operator import iadd

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import spearmanr
from sklearn.metrics import average_precision_score, roc_auc_score

from salsanext_cli.measures.histograms import Histogram, uncertainty_histogram
from salsanext_cli.measures.risk_coverage import (
    COVERAGE,
    kept_points,
    ranking_scores,
    risk_coverage,
    spearman,
)

LEVELS = (0.0, 2.0**-48, 1e-9, 2.0**-10, 0.3, 1.0, 1.0078125, 7.0, 255.0)
"""Uncertainties of different bins."""
POINTS = st.lists(st.tuples(st.sampled_from(LEVELS), st.booleans()), min_size=1, max_size=60)


def of(uncertainty, wrong, group=None, groups=1) -> Histogram:
    values = np.asarray(uncertainty, np.float32)
    group = np.zeros(len(values), int) if group is None else np.asarray(group, int)
    return uncertainty_histogram(values, np.asarray(wrong, bool), group, groups)


def added(histograms) -> Histogram:
    return reduce(iadd, histograms, of([], []))


def scores(points):
    return ranking_scores(of(*zip(*points, strict=True)))


def slow_risks(points) -> list[Fraction]:
    """Return the risk of the k least uncertain points, tied ones being wrong in equal parts."""
    share = {}
    for level in LEVELS:
        tied = [wrong for value, wrong in points if value == level]
        share[level] = Fraction(sum(tied), max(len(tied), 1))
    errors, risks = Fraction(0), []
    for k, (value, _) in enumerate(sorted(points), start=1):
        errors += share[value]
        risks.append(errors / k)
    return risks


def slow_best_risks(points) -> list[Fraction]:
    wrong = sum(wrong for _, wrong in points)
    right = len(points) - wrong
    return [Fraction(max(0, k - right), k) for k in range(1, len(points) + 1)]


def mean(values) -> float:
    return float(sum(values) / len(values))


@given(POINTS.filter(lambda points: len({wrong for _, wrong in points}) == 2))
def test_auroc_and_precision_are_those_of_scikit_learn(points):
    uncertainty, wrong = zip(*points, strict=True)
    assert scores(points).auroc == pytest.approx(roc_auc_score(wrong, uncertainty), abs=1e-13)
    expected = average_precision_score(wrong, uncertainty)
    assert scores(points).aupr == pytest.approx(expected, abs=1e-13)


@given(POINTS)
def test_risk_and_sparsification_are_those_of_a_slow_loop(points):
    result = scores(points)
    risks, best = slow_risks(points), slow_best_risks(points)
    assert result.aurc == pytest.approx(mean(risks), abs=1e-12)
    assert result.excess_aurc == pytest.approx(mean(risks) - mean(best), abs=1e-12)
    counts = of(*zip(*points, strict=True)).counts[:, 0]
    coverage = np.arange(1, len(points) + 1) / len(points)
    np.testing.assert_allclose(
        risk_coverage(*counts, coverage)[0], np.array(risks, float), atol=1e-12
    )
    if not result.wrong:
        assert math.isnan(result.ause)
        return
    # The sparsification curves are these risks from the end, as multiples of the last one.
    gaps = [(risk - least) / risks[-1] for risk, least in zip(risks, best, strict=True)]
    assert result.ause == pytest.approx(mean(gaps), abs=1e-11)


def test_raw_values_are_ranked_nearly_as_exactly():
    """Only pairs within a bin are not told apart, here about one in a thousand."""
    rng = np.random.default_rng(0)
    uncertainty = np.exp(rng.normal(-12, 2, 4000)).astype(np.float32)
    wrong = rng.random(4000) < np.clip(uncertainty * 2e4, 0.05, 0.6)
    result = ranking_scores(of(uncertainty, wrong))
    assert result.auroc == pytest.approx(roc_auc_score(wrong, uncertainty), abs=1e-4)
    assert result.aupr == pytest.approx(average_precision_score(wrong, uncertainty), abs=1e-3)
    risks = wrong[np.argsort(uncertainty)].cumsum() / np.arange(1, 4001)
    assert result.aurc == pytest.approx(risks.mean(), abs=5e-5)
    assert result.mean == pytest.approx(uncertainty.astype(float).mean(), rel=1e-12)


def test_with_nothing_to_find_or_nothing_else_there_is_no_auroc():
    for wrong, auroc, aupr, aurc, ause in (
        ((False, False), math.nan, math.nan, 0, math.nan),
        ((True, True), math.nan, 1, 1, 0),
        ((False,), math.nan, math.nan, 0, math.nan),
        ((True,), math.nan, 1, 1, 0),
    ):
        result = ranking_scores(of([0.3, 1.0][: len(wrong)], wrong))
        found = (result.auroc, result.aupr, result.aurc, result.ause)
        np.testing.assert_array_equal(found, (auroc, aupr, aurc, ause))
        assert (result.points, result.wrong, result.excess_aurc) == (len(wrong), sum(wrong), 0)


@pytest.mark.parametrize("count", [0, 5])
def test_without_values_there_are_no_scores(count):
    nothing = of([math.nan] * count, [True] * count)
    result = ranking_scores(nothing)
    assert (result.points, nothing.left_out, nothing.scans) == (0, count, 0)
    for name in ("mean", "auroc", "aupr", "aurc", "excess_aurc", "ause"):
        assert math.isnan(getattr(result, name)), name
    assert np.isnan(risk_coverage(*nothing.counts[:, 0])).all()


SCANS = st.lists(
    st.lists(st.tuples(st.floats(0, 1e6, width=32), st.booleans()), min_size=1, max_size=9),
    min_size=1,
    max_size=6,
)


@given(SCANS, st.randoms(use_true_random=False))
def test_scores_do_not_depend_on_the_order_of_the_scans(scans, random):
    histograms = [of(*zip(*scan, strict=True)) for scan in scans]
    forth = added(histograms)
    at_once = of(*zip(*chain(*scans), strict=True))
    np.testing.assert_array_equal(forth.counts, at_once.counts)
    assert forth.scans == len(scans)
    random.shuffle(histograms)
    halves = added(histograms[::2]), added(histograms[1::2])
    assert ranking_scores(added(halves)) == ranking_scores(forth)


def test_thresholds_keep_at_least_their_share():
    random = np.random.default_rng(3)
    values = random.lognormal(-4, 1.5, 5000).astype(np.float32)
    wrong = random.random(5000) < 0.2
    counts = of(values, wrong).counts[:, 0]
    _, thresholds = risk_coverage(*counts)
    kept = (values[:, None] <= thresholds).mean(axis=0)
    assert (kept >= COVERAGE - 1e-9).all()
    exact = np.sort(values)[np.ceil(COVERAGE * 5000 - 1e-6).astype(int) - 1]
    np.testing.assert_array_less(exact, thresholds + 1e-12)
    assert (thresholds <= exact * 1.01).all()


PAIRS = st.lists(st.tuples(st.integers(0, 6), st.floats(-1e9, 1e9)), min_size=2, max_size=30)


@given(PAIRS.filter(lambda pairs: all(len(set(column)) > 1 for column in zip(*pairs, strict=True))))
def test_correlation_is_scipys(pairs):
    one, other = (np.array(column) for column in zip(*pairs, strict=True))
    expected = spearmanr(one, other).statistic
    assert spearman(one, other) == pytest.approx(expected, abs=1e-13)


KEPT_LEVELS = (0.0, 2.0**-49, 0.01, 0.1, 0.101, 0.21, 0.5, 0.999, 1.0)
"""Uncertainties of different bins, but for the first two, which are tied."""
KEPT_POINTS = st.lists(
    st.tuples(st.sampled_from(KEPT_LEVELS), st.booleans()), min_size=1, max_size=60
)


@given(KEPT_POINTS)
def test_threshold_is_that_of_a_slow_loop(points):
    values, wrong = (np.array(column) for column in zip(*points, strict=True))
    values[values == KEPT_LEVELS[1]] = 0
    found = kept_points("error", of(values, wrong, np.arange(len(values)) % 3, 3))
    assert found.points == len(points)
    assert found.risk_of_all == wrong.mean()
    coverages = [(values <= level).mean() for level in sorted(set(values))[:-1]]
    if wrong.all() or not wrong.any() or not coverages:
        assert math.isnan(found.threshold)
        assert math.isnan(found.coverage)
        assert "no threshold of error helps" in found.sentence
        return
    assert abs(found.coverage - 0.8) == pytest.approx(min(abs(c - 0.8) for c in coverages))
    kept = values.astype(np.float32) < found.threshold
    assert found.coverage == pytest.approx(kept.mean())
    assert found.risk == pytest.approx(wrong[kept].mean())
    assert found.threshold == float(f"{found.threshold:.4g}")
