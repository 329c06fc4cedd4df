# SPDX-License-Identifier: MIT
"""LeakyReLU and softmax of Gaussians against quadrature, closed forms and Monte Carlo."""

import math
from itertools import pairwise

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import expit
from scipy.stats import norm

from salsanext_cli.uncertainty.adf import MAX_DEVIATIONS, leaky_relu_moments, softmax_moments

SAMPLES = 100_000
FLOATS = [torch.float64, torch.float32, torch.bfloat16, torch.float16]
LEGENDRE = np.polynomial.legendre.leggauss(100)


def draw(*shape, seed=0):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def leaky(mean, variance, slope=0.01, dtype=torch.float64):
    """Return floats for floats."""
    pair = (torch.tensor([number], dtype=dtype) for number in (mean, variance))
    return tuple(t.double().item() for t in leaky_relu_moments(*pair, slope))


def softmax(mean, variance, dtype=torch.float64):
    """Return the moments of one pixel."""
    pair = (torch.as_tensor(numbers, dtype=torch.float64).to(dtype) for numbers in (mean, variance))
    return tuple(t.double() for t in softmax_moments(*pair, 0))


def normal_quadrature(*cuts):
    """Return nodes and weights for N(0, 1), in pieces: exact to the last digits if smooth there."""
    edges = sorted({-MAX_DEVIATIONS, MAX_DEVIATIONS, *(c for c in cuts if abs(c) < MAX_DEVIATIONS)})
    nodes, weights = LEGENDRE
    pieces = [(a, (b - a) / 2) for a, b in pairwise(edges)]
    z = np.concatenate([a + half * (nodes + 1) for a, half in pieces])
    return z, np.concatenate([half * weights for _, half in pieces]) * norm.pdf(z)


def quadrature(function, *cuts):
    """Return mean and variance of function(z), z ~ N(0, 1)."""
    z, weights = normal_quadrature(*cuts)
    values = function(z)
    mean = weights @ values
    return mean, weights @ np.square(values - mean)


@pytest.mark.parametrize("slope", [0.0, 0.01, 0.2, 1.0])
@pytest.mark.parametrize("variance", [1e-12, 1e-6, 1.0, 25.0, 1e6])
def test_leaky_relu_against_quadrature(slope, variance):
    """To 1e-12 of a standard deviation, and of the result where the slope keeps it from 0."""
    deviation = math.sqrt(variance)
    for far in [*np.linspace(-8, 8, 33), -1e-9, 1e-9]:
        mean = far * deviation

        def rectified(z, mean=mean):
            x = mean + deviation * z
            return np.where(x > 0, x, slope * x)

        expected = quadrature(rectified, -far)
        found = leaky(mean, variance, slope)
        assert found[0] == pytest.approx(expected[0], rel=1e-12, abs=1e-14 * deviation)
        assert found[1] == pytest.approx(expected[1], rel=1e-12, abs=1e-14 * variance)


# Softmax


@pytest.mark.parametrize("dtype", FLOATS)
@pytest.mark.parametrize("scale", [1, 10, 30])
def test_certain_logits_give_the_plain_softmax(dtype, scale):
    """To five units in the last place of 1; of a small p, to as many as its logit has and six."""
    logits = (draw(20, 2000) * scale).clamp(-100, 100).to(dtype)
    mean, variance = softmax_moments(logits, torch.zeros_like(logits), 0)
    expected = torch.softmax(logits.double(), dim=0)
    unit = torch.finfo(dtype).eps
    behind = logits.double().amax(dim=0) - logits.double()
    allowed = (expected * (6 + 2 * behind) * unit).clamp(max=5 * unit)
    assert ((mean.double() - expected).abs() <= allowed + torch.finfo(dtype).tiny).all()
    assert torch.equal(variance, torch.zeros_like(logits))


@given(
    st.integers(1, 30),
    st.integers(0, 2**32 - 1),
    st.floats(-2, 2),
    st.floats(-12, 30),
    st.sampled_from(FLOATS[:3]),
)
def test_softmax_stays_within_what_a_probability_can_do(classes, seed, scale, power, dtype):
    """Sum 1; 0 ≤ variance ≤ p (1 − p), whatever certain, vague and huge logits stand together."""
    random = np.random.default_rng(seed)
    logits = random.normal(size=(classes, 50)) * 10**scale
    spread = 10 ** random.uniform(-12, max(power, -12), logits.shape)
    spread[random.random(logits.shape) < 0.2] = 0
    mean, variance = softmax(logits, spread, dtype)
    assert mean.isfinite().all()
    assert variance.isfinite().all()
    assert mean.min() >= 0
    assert variance.min() >= 0
    # A sum of C numbers is rounded C − 1 times; some more roundings are each number's own.
    digits = (4 + classes / 2) * torch.finfo(dtype).eps
    assert (mean.sum(dim=0) - 1).abs().max() <= digits
    assert (variance - mean * (1 - mean)).max() <= digits


@pytest.mark.parametrize(("variance", "worst"), [(1e-6, 1e-6), (0.5, 1e-5), (1.0, 2e-4), (2, 3e-3)])
@pytest.mark.parametrize("ahead", [0, 1, 5, 10, 20])
def test_two_classes_against_quadrature(variance, worst, ahead):
    """With two classes nothing is approximated but the integral."""
    deviation = math.sqrt(2 * variance)
    # The smaller of the two: 1 − p keeps no digits.
    expected = quadrature(lambda z: expit(deviation * z - ahead), ahead / deviation, -3, 3, 6, 9)
    mean, found = softmax([ahead, 0], [variance, variance])
    assert mean[1].item() == pytest.approx(expected[0], rel=worst)
    assert found.sqrt().tolist() == pytest.approx([math.sqrt(expected[1])] * 2, rel=worst)


@pytest.fixture(scope="module")
def noise():
    return draw(SAMPLES, 20, 8)


@pytest.mark.parametrize(
    ("variance", "typical", "worst", "of_class", "of_mean"),
    [(0.1, 0.01, 0.03, 0.003, 0.004), (1, 0.02, 0.2, 0.03, 0.04), (4, 0.04, 0.33, 0.09, 0.18)],
)
def test_accuracy_for_twenty_classes(noise, variance, typical, worst, of_class, of_mean):
    """How far the approximation is from Monte Carlo: measured on 900 pixels, not derived.

    Of a pixel's standard deviation, the root of its mean variance over the classes, the relative
    error in the median and at worst; of one class's, and of its mean, the absolute error at worst.
    The logits are spread by 3, their variances between 0 and twice the one given.
    """
    logits = 3 * draw(20, 8, seed=1)
    variances = 2 * variance * torch.rand(20, 8, generator=torch.Generator().manual_seed(2))
    p = torch.softmax(noise * variances.double().sqrt() + logits, dim=1)
    mean, found = softmax(logits, variances)
    expected = p.var(dim=0)
    error = ((found.mean(dim=0) / expected.mean(dim=0)).sqrt() - 1).abs()
    assert error.median() < typical
    assert error.max() < worst
    assert (found.sqrt() - expected.sqrt()).abs().max() < of_class
    assert (mean - p.mean(dim=0)).abs().max() < of_mean


@pytest.mark.parametrize(
    ("lead", "variance"), [(12.0, 36.0), (8.0, 9.0), (8.0, 4.0), (4.0, 4.0), (2.0, 1.0)]
)
def test_a_sure_class_varies_as_its_one_vague_rival_does(lead, variance):
    """Against 200 000 samples: the log-normal sum alone makes the sure class look certain."""
    logits = torch.zeros(20, 1, dtype=torch.float64)
    logits[0], logits[2:] = lead, -10.0
    variances = torch.full_like(logits, 0.01)
    variances[1] = variance
    random = np.random.default_rng(0)
    noise = random.normal(size=(20, 200_000)) * variances.sqrt().numpy()
    sampled = torch.softmax(torch.from_numpy(logits.numpy() + noise), dim=0).std(dim=1)
    _, found = softmax_moments(logits, variances, 0)
    torch.testing.assert_close(found[:2, 0].sqrt(), sampled[:2], rtol=0.15, atol=0)
