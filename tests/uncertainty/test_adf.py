# SPDX-License-Identifier: MIT
"""Every rule against the function's own derivatives; a chain against Monte Carlo; networks."""

from contextlib import nullcontext

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from hypothesis import given
from hypothesis import strategies as st
from scans import lively
from torch import nn

from salsanext_cli.network.blocks import Unit, average_pooling
from salsanext_cli.network.dropout import ChannelDropout
from salsanext_cli.uncertainty.adf import Gaussian

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


@pytest.fixture(scope="module")
def noise():
    return draw(SAMPLES, *SHAPE[1:], seed=9)


def assert_agrees_with_monte_carlo(function, x, noise):
    """Compare means and variances to within their standard errors."""
    predicted = function(x)
    parts = []
    # Ten parts fit a cache better than the whole.
    for part in noise.chunk(10):
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


def test_a_chain_without_shared_noise_against_monte_carlo(noise):
    """A 1×1 unit, pooling and shuffling: no two numbers that meet depend on each other."""
    chain = nn.Sequential(Unit(4, 8, 1), average_pooling(8, 0.0), nn.PixelShuffle(2))
    assert_agrees_with_monte_carlo(lively(chain).double(), gaussian(*SHAPE), noise)


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


@pytest.mark.parametrize(
    ("function", "name"),
    [
        (torch.relu, "relu"),
        (nn.ELU(), "elu"),
        (nn.MaxPool2d(2), "max_pool2d"),
        (lambda x: torch.ones(()) * x, "mul"),
        (lambda x: 1.0 + draw(*SHAPE) + x, "add"),
    ],
)
def test_a_function_without_a_rule_is_named(function, name):
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
