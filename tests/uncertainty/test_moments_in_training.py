# SPDX-License-Identifier: MIT
"""What training asks of the moments: gradients of every rule, batch norm and dropout drawn anew."""

from copy import deepcopy

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor, nn
from torch.autograd import grad, gradcheck
from torch.func import functional_call
from torch.nn import functional as F

from salsanext_cli.network.blocks import Down, Unit
from salsanext_cli.network.dropout import ChannelDropout
from salsanext_cli.network.salsanext import SalsaNext
from salsanext_cli.uncertainty.adf import Gaussian
from salsanext_cli.uncertainty.logistic import logistic_moments
from salsanext_cli.uncertainty.moments import leaky_relu_moments, softmax_moments

SAMPLES = 20_000
SIGMAS = 5.0
"""Standard errors that a Monte-Carlo estimate may be off: once in two million estimates."""


def draw(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def leaky(mean: Tensor, variance: Tensor) -> tuple[Tensor, Tensor]:
    return leaky_relu_moments(mean, variance, 0.01)


def softmax(mean: Tensor, variance: Tensor) -> tuple[Tensor, Tensor]:
    return softmax_moments(mean, variance, 1)


BOTH = pytest.mark.parametrize("function", [leaky, softmax])


def pulled(function: object, mean: Tensor, variance: Tensor, *of: Tensor) -> tuple[Tensor, Tensor]:
    """Return the gradients of mean and variance, given those of the results."""
    mean, variance = (t.detach().clone().requires_grad_() for t in (mean, variance))
    results = function(mean, variance)  # type: ignore[operator]
    by_mean, by_variance = grad(results, (mean, variance), of)
    return by_mean, by_variance


@BOTH
@pytest.mark.parametrize("scale", [1e-4, 0.1, 10])
def test_gradients_are_those_of_the_values(function: object, scale: float) -> None:
    mean = (2 * draw(2, 4)).requires_grad_()
    variance = (scale * (0.1 + draw(2, 4, seed=1).square())).requires_grad_()
    assert gradcheck(function, (mean, variance), eps=1e-6 * scale, atol=1e-5)


@pytest.mark.parametrize(("variance", "worst"), [(1e-8, 1e-9), (0.1, 1e-9), (1, 1e-4)])
def test_gradients_of_the_logistic_function_are_those_of_the_integral(
    variance: float, worst: float
) -> None:
    """Against autograd through a sum over 4001 nodes; of 12, larger spreads need more."""
    d = torch.linspace(-9, 9, 37, dtype=torch.float64)
    z = torch.linspace(-9, 9, 4001, dtype=torch.float64)
    weights = torch.exp(-z.square() / 2)
    weights /= weights.sum()
    spread = torch.full_like(d, variance)

    def summed(d: Tensor, v: Tensor) -> tuple[Tensor, Tensor]:
        values = torch.sigmoid(d[:, None] + v.sqrt()[:, None] * z)
        mean = values @ weights
        return mean, (values - mean[:, None]).square() @ weights

    for one in range(2):
        of = [torch.full_like(d, float(one == k)) for k in range(2)]
        found = pulled(lambda d, v: logistic_moments(d, v)[::2], d, spread, *of)
        for ours, theirs in zip(found, pulled(summed, d, spread, *of), strict=True):
            assert (ours - theirs).abs().max() <= worst * theirs.abs().max()


@BOTH
def test_what_is_certain_has_the_gradient_of_the_function(function: object) -> None:
    mean, of = draw(3, 6), draw(3, 6, seed=1)
    found, by_variance = pulled(function, mean, torch.zeros_like(mean), of, torch.zeros_like(of))
    mean.requires_grad_()
    plain = mean.softmax(1) if function is softmax else F.leaky_relu(mean, 0.01)
    torch.testing.assert_close(found, grad(plain, mean, of)[0])
    assert by_variance.isfinite().all()


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(-6, 2), st.floats(-12, 12))
def test_gradients_are_finite(seed: int, scale: float, power: float) -> None:
    """Whatever certain, vague and huge numbers stand together, in float32."""
    random = np.random.default_rng(seed)
    mean = np.clip(random.normal(size=(6, 9)) * 10**scale, -100, 100)
    mean[random.random(mean.shape) < 0.1] = 0
    variance = 10 ** random.uniform(-12, max(power, -12), mean.shape)
    variance[random.random(mean.shape) < 0.3] = 0
    pair = (torch.from_numpy(array).float() for array in (mean, variance))
    mean, variance = pair
    for function in (leaky, softmax):
        for found in pulled(function, mean, variance, *torch.ones(2, 6, 9)):
            assert found.isfinite().all()


@BOTH
def test_float32_has_the_gradients_of_float64(function: object) -> None:
    """As large as they are beside the largest: a variance is as small as in a network."""
    mean, variance = 3 * draw(200, 20), 1e-4 * draw(200, 20, seed=1).square()
    of = [draw(200, 20, seed=seed) for seed in (2, 3)]
    narrow = pulled(function, *(t.float() for t in (mean, variance, *of)))
    for ours, wide in zip(narrow, pulled(function, mean, variance, *of), strict=True):
        assert (ours.double() - wide).abs().max() < 1e-4 * wide.abs().max()


class Small(nn.Module):
    """One of every layer that a SalsaNext has."""

    def __init__(self) -> None:
        super().__init__()
        self.unit = Unit(2, 4, 3)
        self.down = Down(0.3)
        self.raised = nn.Sequential(nn.PixelShuffle(2), Unit(1, 2, 2, dilation=2))
        self.logits = nn.Conv2d(6, 3, 1)

    def forward(self, image: Tensor) -> Tensor:
        """Map (B, 2, H, W) to (B, 3, H, W)."""
        features = self.unit(image)
        joined = torch.cat((features, self.raised(self.down(features + features))), dim=1)
        logits: Tensor = self.logits(joined)
        return logits


def test_gradients_through_a_network_in_training() -> None:
    """Of all weights, through batch norm of the batch's own and a drawn dropout."""
    with torch.random.fork_rng():
        torch.manual_seed(1)
        network = Small().double().train()
    names, values = zip(*network.named_parameters(), strict=True)
    x = Gaussian(draw(2, 2, 4, 4), 0.1 * draw(2, 2, 4, 4, seed=1).square())

    def moments(*weights: Tensor) -> tuple[Tensor, Tensor]:
        with torch.random.fork_rng():
            torch.manual_seed(2)
            found = functional_call(network, dict(zip(names, weights, strict=True)), (x,))
        softmax = found.softmax(dim=1)
        return softmax.mean, softmax.variance

    inputs = [value.detach().clone().requires_grad_() for value in values]
    assert gradcheck(moments, inputs, fast_mode=True)
    variance = moments(*inputs)[1].sum()
    assert all(g.abs().max() > 0 for g in grad(variance, inputs))


def test_training_moments_against_monte_carlo() -> None:
    """With the statistics of the batch of means, and the mask, that the moments met."""
    torch.manual_seed(3)
    unit, dropout = Unit(4, 6, 1).double().train(), ChannelDropout(0.4).train()
    unit[2].weight.data, unit[2].bias.data = draw(6, seed=5), draw(6, seed=6)
    x = Gaussian(draw(2, 4, 2, 3), 0.5 + draw(2, 4, 2, 3, seed=1).square())
    met: list[Gaussian] = []
    unit[2].register_forward_pre_hook(lambda layer, given: met.append(given[0]))
    state = torch.get_rng_state()
    with torch.no_grad():
        found = dropout(unit(x))
        torch.set_rng_state(state)
        mask = dropout(torch.ones(2, 6, 1, 1, dtype=torch.float64))
    means = met[0].mean.numpy()
    frozen = deepcopy(unit).eval()
    frozen[2].running_mean[:] = torch.from_numpy(means.mean(axis=(0, 2, 3)))
    frozen[2].running_var[:] = torch.from_numpy(means.var(axis=(0, 2, 3)))
    noise = draw(SAMPLES, *x.shape, seed=9)
    with torch.no_grad():
        samples = frozen((x.mean + x.variance.sqrt() * noise).flatten(0, 1))
    samples = samples.view(SAMPLES, *found.shape) * mask
    square = (samples - found.mean).square()
    error = (found.variance / SAMPLES).sqrt()
    assert ((samples.mean(0) - found.mean).abs() - SIGMAS * error).max() < 1e-12
    error = square.std(0) / SAMPLES**0.5
    assert ((square.mean(0) - found.variance).abs() - SIGMAS * error).max() < 1e-12
    assert (mask == 0).any()
    assert not found.variance[(mask == 0).expand_as(found.variance)].any()


def test_of_a_certain_batch_training_is_that_of_the_network() -> None:
    """Logits and statistics, bit for bit: the same channels are dropped."""
    torch.manual_seed(0)
    plain = SalsaNext(class_count=4, dropout=0.3).train()
    noisy = deepcopy(plain)
    image = draw(2, 5, 16, 32).float()
    with torch.no_grad():
        torch.manual_seed(5)
        expected = plain(image)
        torch.manual_seed(5)
        found = noisy(Gaussian(image, torch.zeros_like(image)))
    assert torch.equal(found.mean, expected)
    assert not found.variance.any()
    for one, other in zip(plain.state_dict().values(), noisy.state_dict().values(), strict=True):
        assert torch.equal(one, other)
