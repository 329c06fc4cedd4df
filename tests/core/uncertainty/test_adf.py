# SPDX-License-Identifier: MIT
"""Every rule against the function's own derivatives, quadrature or Monte Carlo; networks."""

import math
from contextlib import nullcontext
from itertools import pairwise

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from hypothesis import given
from hypothesis import strategies as st
from scans import lively
from scipy.special import expit
from torch import nn

from salsanext_cli.core.network.dropout import ChannelDropout
from salsanext_cli.core.network.salsanext import Unit, average_pooling
from salsanext_cli.core.uncertainty.adf import (
    MAX_DEVIATIONS,
    Gaussian,
    leaky_relu_moments,
    softmax_moments,
)

SAMPLES = 100_000
SIGMAS = 5.0
"""Standard errors that a Monte-Carlo estimate may be off: once in two million estimates."""
SHAPE = 1, 4, 3, 4
FLOATS = [torch.float64, torch.float32, torch.bfloat16]


@pytest.fixture(autouse=True)
def no_gradients():
    with torch.inference_mode():
        yield


def draw(*shape, seed=0):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def gaussian(*shape, seed=0):
    """Return means and variances of order 1, one in eight of them certain.

    No mean is far from 0: what is passed by one sample in thousands has no reliable error.
    """
    variance = 0.5 + draw(*shape, seed=seed + 1).square()
    certain = draw(*shape, seed=seed + 2) < -1.15
    return Gaussian(draw(*shape, seed=seed).clamp(-1.5, 1.5), variance.masked_fill(certain, 0))


def to(x, dtype, layout=torch.contiguous_format):
    mean, variance = (t.to(dtype).contiguous(memory_format=layout) for t in (x.mean, x.variance))
    return Gaussian(mean, variance)


def weights(like, *shape, seed):
    return draw(*shape, seed=seed).to(dtype_of(like))


def dtype_of(x):
    return x.mean.dtype if isinstance(x, Gaussian) else x.dtype


def convolution(kernel, **geometry):
    def rule(x):
        channels = 4 // geometry.get("groups", 1)
        weight = weights(x, 4, channels, *kernel, seed=5)
        return F.conv2d(x, weight, weights(x, 4, seed=6), **geometry)

    return rule


def transposed(kernel, *geometry):
    return lambda x: F.conv_transpose2d(x, weights(x, 4, 2, *kernel, seed=5), None, *geometry)


def batch_norm(x):
    mean, scale, shift = (weights(x, 4, seed=seed) for seed in (5, 6, 7))
    variance = torch.tensor([1e-6, 0.3, 1, 100], dtype=dtype_of(x))
    return F.batch_norm(x, mean, variance, scale, shift, False, 0.1, 1e-5)


LINEAR = {
    "convolution 1×1": convolution((1, 1)),
    "convolution 3×3": convolution((3, 3), padding=1),
    "dilated 2×2": convolution((2, 2), padding=1, dilation=2),
    "strided 3×3 in groups": convolution((3, 3), padding=1, stride=2, groups=2),
    "transposed 3×3": transposed((3, 3), 2, 1, 1),
    "transposed 2×2": transposed((2, 2), 2, 0, 0),
    "transposed 1×4": transposed((1, 4), (1, 2), (0, 1), (0, 0)),
    "batch norm": batch_norm,
    "average pooling": nn.AvgPool2d(3, stride=2, padding=1),
    "pixel shuffle": nn.PixelShuffle(2),
    "padding": lambda x: F.pad(x, (1, 0, 2, 3)),
    "padding around": lambda x: F.pad(x, (2, 1, 0, 0), mode="circular"),
    "padding by repetition": lambda x: F.pad(x, (0, 1, 0, 2), mode="replicate"),
    "indexing": lambda x: x[..., torch.arange(9) % 4][:, 1:, :3],
    "concatenation": lambda x: torch.cat((x[:, 2:], x[:, :1]), dim=1),
    "residual sum": lambda x: x[:, :2] + x[:, 2:],
    "dropout not in training": lambda x: F.dropout2d(x, 0.3, False),
}
RULES = {**LINEAR, "leaky ReLU": nn.LeakyReLU(0.01), "softmax": lambda x: torch.softmax(x, dim=1)}
linear_rules = pytest.mark.parametrize("rule", LINEAR.values(), ids=LINEAR)
rules = pytest.mark.parametrize("rule", RULES.values(), ids=RULES)


def derived(function, x):
    """Return the moments of a linear function: its columns squared, times the variances."""
    size = x.mean.numel()
    zero = function(torch.zeros_like(x.mean))
    units = torch.eye(size, dtype=x.mean.dtype).view(size, *x.shape[1:])
    columns = function(units) - zero
    return function(x.mean), (columns.square().flatten(1).T @ x.variance.flatten()).view(zero.shape)


def test_a_chain_without_shared_noise_against_monte_carlo():
    """A 1×1 unit, pooling and shuffling: no two numbers that meet depend on each other."""
    chain = nn.Sequential(Unit(4, 8, 1), average_pooling(0.0), nn.PixelShuffle(2))
    function, x = lively(chain).double(), gaussian(*SHAPE)
    predicted = function(x)
    parts = []
    # Ten parts fit a cache better than the whole.
    for part in draw(SAMPLES, *SHAPE[1:], seed=9).chunk(10):
        off = function(x.mean + x.variance.sqrt() * part) - predicted.mean
        square = off.square()
        parts.append(torch.stack([t.mean(dim=0) for t in (off, square, square.square())]))
    first, second, fourth = torch.stack(parts).mean(dim=0)
    variance = predicted.variance[0]
    error_of_mean = (variance / SAMPLES).sqrt()
    error_of_variance = ((fourth - second.square()).clamp(min=0) / SAMPLES).sqrt()
    # What is certain has no error but that of adding numbers of order 1 in another order.
    assert (first.abs() - SIGMAS * error_of_mean).max() < 1e-14
    assert ((second - variance).abs() - SIGMAS * error_of_variance).max() < 1e-14


@linear_rules
def test_linear_rules_are_exact(rule):
    x = gaussian(*SHAPE)
    found = rule(x)
    mean, variance = derived(rule, x)
    assert torch.equal(found.mean, mean)
    torch.testing.assert_close(found.variance, variance, rtol=1e-13, atol=1e-15)


@pytest.mark.parametrize("dtype", FLOATS)
@rules
def test_certain_numbers_stay_certain(rule, dtype):
    """Of variance 0, the mean is that of the function, bit for bit, and the variance 0."""
    mean = (30 * draw(*SHAPE)).clamp(-100, 100).to(dtype)
    found, expected = rule(Gaussian(mean, torch.zeros_like(mean))), rule(mean)
    if rule is RULES["softmax"]:
        torch.testing.assert_close(found.mean, expected, rtol=0, atol=5 * torch.finfo(dtype).eps)
    else:
        assert torch.equal(found.mean, expected)
    assert found.mean.dtype == found.variance.dtype == dtype
    assert not found.variance.any()


@given(
    st.integers(0, 2**32 - 1),
    st.floats(-6, 2),
    st.floats(-12, 30),
    st.sampled_from(FLOATS),
    st.sampled_from([torch.contiguous_format, torch.channels_last]),
)
def test_variances_are_finite_and_not_negative(seed, scale, power, dtype, layout):
    """From certain to huge side by side, in any type and layout."""
    random = np.random.default_rng(seed)
    mean = np.clip(random.normal(size=SHAPE) * 10**scale, -100, 100)
    variance = 10 ** random.uniform(-12, max(power, -12), SHAPE)
    variance[random.random(SHAPE) < 0.3] = 0
    x = to(Gaussian(torch.from_numpy(mean), torch.from_numpy(variance)), dtype, layout)
    for name, rule in RULES.items():
        found, shape = rule(x), rule(x.mean).shape
        assert found.shape == shape, name
        assert found.mean.isfinite().all(), name
        assert found.variance.isfinite().all(), name
        assert found.variance.min() >= 0, name


# PyTorch says so wherever oneDNN is switched off.
@pytest.mark.filterwarnings("ignore:TF32 acceleration")
@pytest.mark.parametrize("batch", [1, 16])
@pytest.mark.parametrize("own", [True, False])
def test_convolutions_by_any_algorithm_give_no_negative_variance(batch, own):
    """Beside large variances, an algorithm that transforms leaves less than 0 of a 0."""
    mean = torch.zeros(batch, 32, 16, 64)
    vague = torch.rand(mean.shape, generator=torch.Generator().manual_seed(0)) < 0.02
    weight = draw(32, 32, 3, 3).float()
    with nullcontext() if own else torch.backends.mkldnn.flags(enabled=False):
        found = F.conv2d(Gaussian(mean, 1e6 * vague.float()), weight, padding=1)
    assert found.variance.min() >= 0


def test_a_function_without_a_rule_is_named():
    for function, name in (
        (torch.relu, "relu"),
        (nn.ELU(), "elu"),
        (nn.MaxPool2d(2), "max_pool2d"),
        (lambda x: torch.ones(()) * x, "mul"),
        (lambda x: 1.0 + draw(*SHAPE) + x, "add"),
    ):
        with pytest.raises(NotImplementedError, match=f"no rule for the moments of .*{name}"):
            function(gaussian(*SHAPE))


def test_what_the_rules_do_not_cover_is_an_error():
    x = gaussian(*SHAPE)
    with pytest.raises(NotImplementedError, match="average pooling"):
        nn.AvgPool2d(3, stride=2, padding=1, count_include_pad=False)(x)
    for layer in (nn.BatchNorm2d(4), ChannelDropout(0.3)):
        with pytest.raises(NotImplementedError, match="in training"):
            layer.train()(x)
    with pytest.raises(ValueError, match=r"\(1, 4\) and variance \(4,\) differ in shape"):
        Gaussian(torch.zeros(1, 4), torch.zeros(4))


LEGENDRE = np.polynomial.legendre.leggauss(100)


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
    density = np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi)
    return z, np.concatenate([half * weights for _, half in pieces]) * density


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


@pytest.mark.parametrize("dtype", [*FLOATS, torch.float16])
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
    st.sampled_from(FLOATS),
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


@pytest.mark.parametrize(
    ("variance", "typical", "worst", "of_class", "of_mean"),
    [(0.1, 0.01, 0.03, 0.003, 0.004), (1, 0.02, 0.2, 0.03, 0.04), (4, 0.04, 0.33, 0.09, 0.18)],
)
def test_accuracy_for_twenty_classes(variance, typical, worst, of_class, of_mean):
    """How far the approximation is from Monte Carlo: measured on 900 pixels, not derived.

    Of a pixel's standard deviation, the root of its mean variance over the classes, the relative
    error in the median and at worst; of one class's, and of its mean, the absolute error at worst.
    The logits are spread by 3, their variances between 0 and twice the one given.
    """
    logits = 3 * draw(20, 8, seed=1)
    variances = 2 * variance * torch.rand(20, 8, generator=torch.Generator().manual_seed(2))
    p = torch.softmax(draw(SAMPLES, 20, 8) * variances.double().sqrt() + logits, dim=1)
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
