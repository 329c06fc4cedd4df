# SPDX-License-Identifier: MIT

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from shallow import slow_on_openvino

from salsanext_cli.engines.loading import with_dropout
from salsanext_cli.uncertainty.dropout_propagation import (
    ChannelCorrelatedGaussian,
    propagate_dropout,
)
from salsanext_cli.uncertainty.monte_carlo import sample

COUNT = 25_000


def together(shape, seed=0):
    """Return means and deviations, and samples that are wrong alike in the whole of a channel."""
    random = torch.Generator().manual_seed(seed)
    mean = torch.randn(1, *shape, generator=random, dtype=torch.float64)
    deviation = torch.rand(1, shape[0], 1, 1, generator=random, dtype=torch.float64)
    errors = torch.randn(COUNT, shape[0], 1, 1, generator=random, dtype=torch.float64)
    variance = (deviation.square()).expand(1, *shape)
    return ChannelCorrelatedGaussian(mean, variance.contiguous()), mean + deviation * errors


@pytest.mark.parametrize(("kernel", "padding", "dilation"), [(1, 0, 1), (3, 0, 1), (2, 0, 2)])
def test_convolution(kernel, padding, dilation):
    x, samples = together((3, 5, 5))
    random = torch.Generator().manual_seed(1)
    weight = torch.randn(4, 3, kernel, kernel, generator=random, dtype=torch.float64)
    bias = torch.randn(4, generator=random, dtype=torch.float64)
    found = F.conv2d(x, weight, bias, padding=padding, dilation=dilation)
    sampled = F.conv2d(samples, weight, bias, padding=padding, dilation=dilation)
    assert isinstance(found, ChannelCorrelatedGaussian)
    closed = F.conv2d(x.mean, weight, bias, padding=padding, dilation=dilation)
    torch.testing.assert_close(found.mean, closed)
    # The standard error of a variance is √(2/n) of it; over 36 cells, 4 of them.
    torch.testing.assert_close(found.variance[0], sampled.var(dim=0), rtol=0.036, atol=0)


def test_transposed_convolution():
    """Exact where the window lies inside; what is missing at the edge is taken to be there."""
    for kernel, geometry in (
        ((3, 3), ((2, 2), (1, 1), (1, 1))),
        ((3, 3), ((2, 2), (1, 1), (0, 0))),
        ((2, 2), ((2, 2), (0, 0), (0, 0))),
        ((1, 4), ((1, 2), (0, 1), (0, 0))),
    ):
        x, _ = together((3, 5, 5))
        random = torch.Generator().manual_seed(1)
        weight = torch.randn(3, 2, *kernel, generator=random, dtype=torch.float64)
        found = F.conv_transpose2d(x, weight, None, *geometry)
        assert isinstance(found, ChannelCorrelatedGaussian)
        torch.testing.assert_close(found.mean, F.conv_transpose2d(x.mean, weight, None, *geometry))
        deviations = torch.zeros_like(found.variance)
        for channel in range(3):
            alone = torch.zeros_like(x.mean)
            alone[:, channel] = x.variance[:, channel].sqrt()
            deviations += F.conv_transpose2d(alone, weight, None, *geometry).square()
        inside = (..., slice(2, -2) if kernel[0] > 1 else slice(None), slice(2, -2))
        torch.testing.assert_close(found.variance[inside], deviations[inside])


def test_average_pooling():
    x, samples = together((3, 7, 7))
    found = F.avg_pool2d(x, 3, 2, 0)
    sampled = F.avg_pool2d(samples, 3, 2, 0)
    torch.testing.assert_close(found.variance[0], sampled.var(dim=0), rtol=0.036, atol=0)


def test_dropout():
    """Its two values in closed form, over the variance that is there already."""
    x, _ = together((3, 2, 2))
    found = F.dropout2d(x, 0.3, False)
    kept = 1 / 0.7
    second = 0.7 * kept**2 * (x.mean**2 + x.variance)
    torch.testing.assert_close(found.mean, x.mean)
    torch.testing.assert_close(found.variance, second - x.mean**2)
    nothing = F.dropout2d(x, 0.0, False)
    torch.testing.assert_close(nothing.variance, x.variance)


@slow_on_openvino
def test_it_ranks_pixels_as_sampling_does(network, image):
    occupied = image.channels[0] > 0
    mild = with_dropout(network, 0.05)
    passes = sample(mild, image, samples=60, seed=0).uncertainty
    once = propagate_dropout(mild, image).uncertainty
    for kind in ("epistemic", "entropy"):
        values = (getattr(u, kind)[occupied] for u in (passes, once))
        ranks = (np.argsort(np.argsort(v)) for v in values)
        assert np.corrcoef(*ranks)[0, 1] > 0.6
