# SPDX-License-Identifier: MIT
"""How well uncertainties rank points, and how well probabilities are calibrated."""

import math
from fractions import Fraction
from functools import reduce
from itertools import chain
from operator import iadd
from types import ModuleType

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import entr

from salsanext_cli.core.measures.calibration import calibration_scores, reliability
from salsanext_cli.core.measures.histograms import (
    MIN_PROBABILITY,
    Histogram,
    confidence_histogram,
    lack_of_confidence,
    softmax_entropy,
    uncertainty_histogram,
)
from salsanext_cli.core.measures.uncertainty_evaluation import (
    COVERAGE,
    accepted_points,
    ranking_scores,
    risk_coverage,
)
from salsanext_cli.core.plain_data import plain

LEVELS = (0.0, 2.0**-48, 1e-9, 2.0**-10, 0.3, 1.0, 1.0078125, 7.0, 255.0)
"""Uncertainties of different bins."""
POINTS = st.lists(st.tuples(st.sampled_from(LEVELS), st.booleans()), min_size=1, max_size=60)


def of(uncertainty, wrong) -> Histogram:
    return uncertainty_histogram(np.asarray(uncertainty, np.float32), np.asarray(wrong, bool))


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


@pytest.fixture(scope="module")
def metrics() -> ModuleType:
    """Return the measures of scikit-learn, which takes a second to import."""
    from sklearn import metrics

    return metrics


@given(POINTS.filter(lambda points: len({wrong for _, wrong in points}) == 2))
def test_auroc_and_precision_are_those_of_scikit_learn(metrics, points):
    uncertainty, wrong = zip(*points, strict=True)
    assert scores(points).auroc == pytest.approx(
        metrics.roc_auc_score(wrong, uncertainty), abs=1e-13
    )
    expected = metrics.average_precision_score(wrong, uncertainty)
    assert scores(points).aupr == pytest.approx(expected, abs=1e-13)


@given(POINTS)
def test_risk_and_sparsification_are_those_of_a_slow_loop(points):
    result = scores(points)
    risks, best = slow_risks(points), slow_best_risks(points)
    assert result.aurc == pytest.approx(mean(risks), abs=1e-12)
    assert result.excess_aurc == pytest.approx(mean(risks) - mean(best), abs=1e-12)
    counts = of(*zip(*points, strict=True)).counts
    coverage = np.arange(1, len(points) + 1) / len(points)
    found = risk_coverage(*counts, coverage)[0]
    np.testing.assert_allclose(found, np.array(risks, float), atol=1e-12)
    if not result.wrong:
        assert math.isnan(result.ause)
        return
    # The sparsification curves are these risks from the end, as multiples of the last one.
    gaps = [(risk - least) / risks[-1] for risk, least in zip(risks, best, strict=True)]
    assert result.ause == pytest.approx(mean(gaps), abs=1e-11)


def test_binned_values_rank_nearly_as_raw_values(metrics):
    """Pairs within a bin are tied, here about one in a thousand."""
    rng = np.random.default_rng(0)
    uncertainty = np.exp(rng.normal(-12, 2, 4000)).astype(np.float32)
    wrong = rng.random(4000) < np.clip(uncertainty * 2e4, 0.05, 0.6)
    result = ranking_scores(of(uncertainty, wrong))
    assert result.auroc == pytest.approx(metrics.roc_auc_score(wrong, uncertainty), abs=1e-4)
    assert result.aupr == pytest.approx(
        metrics.average_precision_score(wrong, uncertainty), abs=1e-3
    )
    risks = wrong[np.argsort(uncertainty)].cumsum() / np.arange(1, 4001)
    assert result.aurc == pytest.approx(risks.mean(), abs=5e-5)
    assert result.mean == pytest.approx(uncertainty.astype(float).mean(), rel=1e-12)


def test_points_of_one_kind_have_no_auroc():
    for wrong, auroc, aupr, aurc, ause in (
        ((False, False), math.nan, math.nan, 0, math.nan),
        ((True, True), math.nan, 1, 1, 0),
        ((False,), math.nan, math.nan, 0, math.nan),
        ((True,), math.nan, 1, 1, 0),
    ):
        result = ranking_scores(of([0.3, 1.0][: len(wrong)], wrong))
        areas = (result.auroc, result.aupr, result.aurc, result.ause)
        np.testing.assert_array_equal(areas, (auroc, aupr, aurc, ause))
        assert (result.points, result.wrong, result.excess_aurc) == (len(wrong), sum(wrong), 0)


@pytest.mark.parametrize("count", [0, 5])
def test_without_values_there_are_no_scores(count):
    nothing = of([math.nan] * count, [True] * count)
    result = ranking_scores(nothing)
    assert (result.points, nothing.without_value, nothing.scans) == (0, count, 0)
    for name in ("mean", "auroc", "aupr", "aurc", "excess_aurc", "ause"):
        assert math.isnan(getattr(result, name)), name
    assert np.isnan(risk_coverage(*nothing.counts)).all()


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
    assert plain(ranking_scores(added(halves))) == plain(ranking_scores(forth))


def test_thresholds_accept_at_least_their_share():
    random = np.random.default_rng(3)
    values = random.lognormal(-4, 1.5, 5000).astype(np.float32)
    wrong = random.random(5000) < 0.2
    counts = of(values, wrong).counts
    _, thresholds = risk_coverage(*counts)
    assert ((values[:, None] <= thresholds).mean(axis=0) >= COVERAGE - 1e-9).all()
    exact = np.sort(values)[np.ceil(COVERAGE * 5000 - 1e-6).astype(int) - 1]
    np.testing.assert_array_less(exact, thresholds + 1e-12)
    assert (thresholds <= exact * 1.01).all()


ERRORS = (0.0, 2.0**-49, 0.01, 0.1, 0.101, 0.21, 0.5, 0.999, 1.0)
"""Uncertainties of different bins, except that the first two are tied."""


@given(st.lists(st.tuples(st.sampled_from(ERRORS), st.booleans()), min_size=1, max_size=60))
def test_threshold_is_that_of_a_slow_loop(points):
    values, wrong = (np.array(column) for column in zip(*points, strict=True))
    values[values == ERRORS[1]] = 0
    result = accepted_points("error", of(values, wrong))
    assert result.points == len(points)
    assert result.risk_of_all == wrong.mean()
    coverages = [(values <= level).mean() for level in sorted(set(values))[:-1]]
    if wrong.all() or not wrong.any() or not coverages:
        assert math.isnan(result.threshold)
        assert math.isnan(result.coverage)
        assert result.sentence
        return
    assert abs(result.coverage - 0.8) == pytest.approx(min(abs(c - 0.8) for c in coverages))
    accepted = values.astype(np.float32) < result.threshold
    assert result.coverage == pytest.approx(accepted.mean())
    assert result.risk == pytest.approx(wrong[accepted].mean())
    assert result.threshold == float(f"{result.threshold:.4g}")


C = 4
SEEDS = pytest.mark.parametrize("seed", range(4))


def softmax(seed: int, count: int = 200, scale: float = 3) -> tuple[np.ndarray, np.ndarray]:
    """Return float16 probabilities, some of them rounded to 0 and 1, and true classes."""
    rng = np.random.default_rng(seed)
    logits = rng.normal(0, scale, (count, C))
    powers = np.exp(logits - logits.max(axis=1, keepdims=True))
    probabilities = (powers / powers.sum(axis=1, keepdims=True)).astype(np.float16)
    other = rng.integers(0, C, count)
    return probabilities, np.where(rng.random(count) < 0.4, other, probabilities.argmax(axis=1))


def slow_error(probabilities: np.ndarray, truth: np.ndarray, bins: int) -> float:
    held = [[] for _ in range(bins)]
    for row, true in zip(probabilities.astype(float), truth, strict=True):
        b = 0
        while row.max() > (b + 1) / bins:
            b += 1
        held[b].append((row.max(), row.argmax() == true))
    gaps = [abs(sum(hit for _, hit in b) - sum(p for p, _ in b)) for b in held]
    return sum(gaps) / len(truth)


@SEEDS
def test_log_likelihood_and_brier_are_those_of_scikit_learn(metrics, seed):
    probabilities, truth = softmax(seed)
    exact = probabilities.astype(float)
    exact /= exact.sum(axis=1, keepdims=True)
    expected = metrics.brier_score_loss(truth, exact, labels=range(C), scale_by_half=False)
    assert calibration_scores(confidence_histogram(exact, truth)).brier == pytest.approx(
        expected, rel=1e-12
    )
    clamped = np.maximum(probabilities.astype(float), MIN_PROBABILITY)
    # Rows that do not sum to 1 are scaled there, so the true class's share is given as one of two.
    of_truth = clamped[np.arange(len(truth)), truth]
    pairs = np.stack([1 - of_truth, of_truth], axis=1)
    expected = metrics.log_loss(np.ones(len(truth)), pairs, labels=[0, 1])
    scores = calibration_scores(confidence_histogram(probabilities, truth))
    assert scores.nll == pytest.approx(expected, rel=1e-12)


@SEEDS
@pytest.mark.parametrize("scale", [0.1, 1, 5])
def test_errors_are_those_of_a_slow_loop(seed, scale):
    probabilities, truth = softmax(seed, 300, scale)
    histogram = confidence_histogram(probabilities, truth)
    result = calibration_scores(histogram)
    assert result.ece == pytest.approx(slow_error(probabilities, truth, 15), abs=1e-14)
    of_ten_bins = reliability(histogram.counts, 10)
    assert of_ten_bins.error == pytest.approx(slow_error(probabilities, truth, 10))


def test_a_probability_of_0_costs_as_much_as_the_smallest_float16_and_none_nothing():
    probabilities = np.array([[1, 0, 0, 0]], np.float16)
    result = calibration_scores(confidence_histogram(probabilities, np.array([1])))
    assert result.nll == pytest.approx(24 * math.log(2))
    assert result.brier == 2
    assert result.ece == 1
    probabilities, truth = softmax(1)
    some = probabilities.copy()
    some[::2] = np.nan
    histogram = confidence_histogram(some, truth)
    assert histogram.without_value == 100
    others = confidence_histogram(probabilities[1::2], truth[1::2])
    without = {"without_value": 0}
    assert plain(calibration_scores(histogram)) | without == plain(calibration_scores(others))


@pytest.mark.parametrize("count", [0, 3])
def test_without_points_there_are_no_scores(count):
    nothing = confidence_histogram(np.full((count, C), np.nan, np.float16), np.zeros(count, int))
    result = calibration_scores(nothing)
    assert (result.points, nothing.scans, nothing.without_value) == (0, 0, count)
    for name in ("nll", "brier", "ece"):
        assert math.isnan(getattr(result, name)), name


def test_entropy_is_that_of_scipy_and_lack_of_confidence_that_of_the_largest():
    powers = np.exp(np.random.default_rng(0).normal(0, 4, (300, 20)))
    softmax = powers / powers.sum(axis=1, keepdims=True)
    entropies = softmax_entropy(softmax)
    assert entropies.dtype == np.float32
    np.testing.assert_allclose(entropies, entr(softmax).sum(axis=1), atol=1e-5)
    np.testing.assert_allclose(lack_of_confidence(softmax), 1 - softmax.max(axis=1), atol=1e-6)
    rows = np.array([[1 - 1e-4, 1e-4], [1 - 1e-5, 1e-5]], np.float16)
    assert (rows[:, 0] == 1).all()
    np.testing.assert_allclose(lack_of_confidence(rows), [1e-4, 1e-5], rtol=5e-3)
