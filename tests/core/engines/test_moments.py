# SPDX-License-Identifier: MIT
"""Sums over passes have the mean, the variance and the entropy of NumPy and SciPy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import entr

from salsanext_cli.core.engines.moments import Moments, entropy

SHAPE = (5, 6, 40)


def softmax(seed: int) -> np.ndarray:
    """Return probabilities (C, H, W) float32."""
    logits = np.random.default_rng(seed).normal(scale=3, size=SHAPE)
    powers = np.exp(logits)
    return (powers / powers.sum(axis=0)).astype(np.float32)


def no_moments() -> Moments:
    return Moments(0, np.zeros(SHAPE), np.zeros(SHAPE), np.zeros(SHAPE[1:]))


@pytest.mark.parametrize("count", [1, 2, 7])
def test_mean_variance_and_entropy_are_those_of_all_passes(count):
    passes = np.stack([softmax(seed) for seed in range(count)])
    moments = no_moments()
    for values in passes:
        moments.add(values, entropy(values), None)
    exact = passes.astype(np.float64)
    np.testing.assert_allclose(moments.mean(), exact.mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(moments.variance(), exact.var(axis=0), atol=1e-14)
    nats = entr(exact).sum(axis=(0, 1))
    np.testing.assert_allclose(moments.sum_of_entropies, nats, rtol=1e-5)
    if count > 1:
        unbiased = exact.var(axis=0, ddof=1)
        np.testing.assert_allclose(moments.unbiased_variance(), unbiased, atol=1e-7)
    spread = moments.spread()
    np.testing.assert_allclose(spread.mean, exact.mean(axis=0), rtol=1e-6)
    np.testing.assert_allclose(spread.epistemic, exact.var(axis=0).mean(axis=0), atol=1e-7)
    total = entr(exact.mean(axis=0)).sum(axis=0)
    np.testing.assert_allclose(spread.entropy, total, rtol=1e-5)
    np.testing.assert_allclose(spread.mutual_information, total - nats / count, atol=2e-5)


def test_equal_passes_have_no_variance():
    moments = no_moments()
    for _ in range(3):
        moments.add(softmax(1), None, None)
    assert moments.variance().min() >= 0
    assert moments.variance().max() < 1e-15
    assert not moments.sum_of_entropies.any()


@given(st.lists(st.floats(0, 1), min_size=2, max_size=20).filter(any))
def test_an_entropy_is_that_of_scipy_and_never_negative(weights):
    probabilities = np.array(weights) / sum(weights)
    nats = float(entropy(probabilities))
    assert nats >= 0
    assert nats == pytest.approx(entr(probabilities).sum(), abs=1e-9)


def test_a_softmax_that_was_rounded_to_above_one_has_no_entropy():
    assert entropy(np.array([1 + 1e-7, 0], np.float32)) == 0
