# SPDX-License-Identifier: MIT
"""Calibration of softmax, and what histograms keep of it."""

import math

import numpy as np
import pytest
from scipy.stats import entropy
from sklearn.metrics import brier_score_loss, log_loss

from salsanext_cli.measures.calibration import calibration_scores, reliability
from salsanext_cli.measures.histograms import (
    MIN_PROBABILITY,
    Histogram,
    confidence_histogram,
    lack_of_confidence,
    softmax_entropy,
    softmax_errors,
)

C = 4
SEEDS = pytest.mark.parametrize("seed", range(4))


def softmax(seed: int, count: int = 200, scale: float = 3) -> tuple[np.ndarray, np.ndarray]:
    """Return float16 probabilities, some of them rounded to 0 and 1, and true classes."""
    rng = np.random.default_rng(seed)
    logits = rng.normal(0, scale, (count, C))
    powers = np.exp(logits - logits.max(axis=1, keepdims=True))
    probabilities = (powers / powers.sum(axis=1, keepdims=True)).astype(np.float16)
    guess = rng.integers(0, C, count)
    return probabilities, np.where(rng.random(count) < 0.4, guess, probabilities.argmax(axis=1))


def of(probabilities: np.ndarray, truth: np.ndarray) -> Histogram:
    return confidence_histogram(softmax_errors(probabilities, truth), truth, C)


def slow_error(probabilities: np.ndarray, truth: np.ndarray, bins: int) -> float:
    held = [[] for _ in range(bins)]
    for row, true in zip(probabilities.astype(float), truth, strict=True):
        b = 0
        while row.max() > (b + 1) / bins:
            b += 1
        held[b].append((row.max(), row.argmax() == true))
    gaps = [abs(sum(hit for _, hit in b) - sum(p for p, _ in b)) for b in held]
    return sum(gaps) / len(truth)


def slow_adaptive_error(probabilities: np.ndarray, truth: np.ndarray, bins: int) -> float:
    """Sort, replace those of one confidence by their mean, cut into bins of one size."""
    confidence = probabilities.max(axis=1).astype(float)
    hit = (probabilities.argmax(axis=1) == truth).astype(float)
    for value in set(confidence):
        hit[confidence == value] = hit[confidence == value].mean()
    order = np.argsort(confidence)
    chunks = np.array_split(order, bins)
    assert len({len(chunk) for chunk in chunks}) == 1
    return sum(abs(hit[c].mean() - confidence[c].mean()) for c in chunks) / bins


@SEEDS
def test_log_likelihood_and_brier_are_those_of_scikit_learn(seed):
    probabilities, truth = softmax(seed)
    exact = probabilities.astype(float)
    exact /= exact.sum(axis=1, keepdims=True)
    expected = brier_score_loss(truth, exact, labels=range(C), scale_by_half=False)
    assert calibration_scores(of(exact, truth)).brier == pytest.approx(expected, rel=1e-12)
    clamped = np.maximum(probabilities.astype(float), MIN_PROBABILITY)
    # Rows that do not sum to 1 are scaled there, so the true class's share is given as one of two.
    of_truth = clamped[np.arange(len(truth)), truth]
    pairs = np.stack([1 - of_truth, of_truth], axis=1)
    expected = log_loss(np.ones(len(truth)), pairs, labels=[0, 1])
    assert calibration_scores(of(probabilities, truth)).nll == pytest.approx(expected, rel=1e-12)


@SEEDS
@pytest.mark.parametrize("scale", [0.1, 1, 5])
def test_errors_are_those_of_a_slow_loop(seed, scale):
    probabilities, truth = softmax(seed, 300, scale)
    histogram = of(probabilities, truth)
    result = calibration_scores(histogram)
    assert result.ece == pytest.approx(slow_error(probabilities, truth, 15), abs=1e-14)
    of_ten_bins = reliability(histogram.total().counts[:, 0], 10)
    assert of_ten_bins.error == pytest.approx(slow_error(probabilities, truth, 10))
    assert result.ace == pytest.approx(slow_adaptive_error(probabilities, truth, 15), abs=1e-14)
    hits = probabilities.argmax(axis=1) == truth
    assert result.accuracy == hits.mean()
    assert result.confidence == pytest.approx(probabilities.max(axis=1).astype(float).mean())


def test_a_probability_of_0_costs_as_much_as_the_smallest_float16():
    probabilities = np.array([[1, 0, 0, 0]], np.float16)
    result = calibration_scores(of(probabilities, np.array([1])))
    assert result.nll == pytest.approx(24 * math.log(2))
    assert result.brier == 2
    assert result.ece == result.ace == 1


def test_groups_are_separate_and_points_without_a_softmax_left_out():
    probabilities, truth = softmax(1)
    some = probabilities.copy()
    some[::2] = np.nan
    by_truth = of(some, truth)
    assert by_truth.left_out == 100
    assert by_truth.points.tolist() == np.bincount(truth[1::2], minlength=C).tolist()
    for i in range(C):
        alone = of(probabilities[1::2][truth[1::2] == i], truth[1::2][truth[1::2] == i])
        assert calibration_scores(by_truth.group(i)) == calibration_scores(alone)


@pytest.mark.parametrize("count", [0, 3])
def test_without_points_there_are_no_scores(count):
    nothing = of(np.full((count, C), np.nan, np.float16), np.zeros(count, int))
    result = calibration_scores(nothing)
    assert (result.points, nothing.scans, nothing.left_out) == (0, 0, count)
    for name in ("confidence", "accuracy", "nll", "brier", "ece", "ace"):
        assert math.isnan(getattr(result, name)), name


def test_entropy_is_that_of_scipy_and_lack_of_confidence_that_of_the_largest():
    powers = np.exp(np.random.default_rng(0).normal(0, 4, (300, 20)))
    softmax = powers / powers.sum(axis=1, keepdims=True)
    found = softmax_entropy(softmax)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, entropy(softmax, axis=1), atol=1e-5)
    np.testing.assert_allclose(lack_of_confidence(softmax), 1 - softmax.max(axis=1), atol=1e-6)
    rows = np.array([[1 - 1e-4, 1e-4], [1 - 1e-5, 1e-5]], np.float16)
    assert (rows[:, 0] == 1).all()
    np.testing.assert_allclose(lack_of_confidence(rows), [1e-4, 1e-5], rtol=5e-3)
