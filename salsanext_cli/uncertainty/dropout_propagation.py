# SPDX-License-Identifier: MIT
"""Epistemic uncertainty in one pass: the noise of dropout is propagated instead of sampled.

A dropped channel is dropped at all of its pixels, so what it does to neighbouring pixels does not
average out, as independent noise would.
"""

from collections.abc import Sequence
from itertools import product
from typing import Any, ClassVar

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from salsanext_cli.engines.moments import entropy
from salsanext_cli.engines.network import Network
from salsanext_cli.network.dropout import require_dropout
from salsanext_cli.network.segmentation import SegmentationNetwork
from salsanext_cli.records import Double, RangeImage
from salsanext_cli.uncertainty.adf import Gaussian
from salsanext_cli.uncertainty.estimate import Estimate

MIN_MEAN = 1e-12  # Least divisor, of a probability


class ChannelCorrelatedGaussian(Gaussian):
    """Gaussians that are independent between channels, but move together within one.

    At a pixel, the neighbours of its window are taken to have its window's mean variance, and the
    image to go on beyond its border; the numbers that a pixel shuffle makes neighbours are taken
    to move together too. It is an estimate, to be judged by how it ranks.
    """

    __slots__ = ()
    RULES: ClassVar = {}


def _conv2d(
    x: ChannelCorrelatedGaussian,
    weight: Tensor,
    bias: Tensor | None = None,
    stride: Any = 1,
    padding: Any = 0,
    dilation: Any = 1,
    groups: int = 1,
) -> ChannelCorrelatedGaussian:
    """Var = (Σ W)² ∗ v, the sum over the window: k equal deviations add up, not their squares."""
    mean = F.conv2d(x.mean, weight, bias, stride, padding, dilation, groups)
    variance = x.variance
    if weight.shape[2:].numel() > 1:
        channels, window = variance.shape[1], weight.shape[2:]
        box = torch.full((channels, 1, *window), 1 / window.numel()).to(variance)
        within = F.conv2d(torch.ones_like(variance), box, None, stride, padding, dilation, channels)
        variance = F.conv2d(variance, box, None, stride, padding, dilation, channels)
        # Low levels may have windows all of which lies outside.
        variance = variance / within.clamp(min=0.5 / window.numel())
    together = weight.sum(dim=(2, 3), keepdim=True).square()
    # Some backends convolve through transforms, whose rounding can fall below 0.
    return x.like(mean, F.conv2d(variance, together, groups=groups).clamp_(min=0))


def _conv_transpose2d(
    x: ChannelCorrelatedGaussian,
    weight: Tensor,
    bias: Tensor | None = None,
    stride: Sequence[int] = (1, 1),
    padding: Sequence[int] = (0, 0),
    output_padding: Sequence[int] = (0, 0),
    groups: int = 1,
    dilation: Any = 1,
) -> ChannelCorrelatedGaussian:
    """Var = (Σ W)² ∗ v, the sum over those of the weights that meet at a pixel."""
    # They differ between the stride² positions of a pixel in its cell, so each is summed apart.
    geometry = (stride, padding, output_padding)
    mean = F.conv_transpose2d(x.mean, weight, bias, *geometry, groups, dilation)
    channels = weight.shape[0]
    ones = torch.ones((channels, 1, *weight.shape[2:])).to(weight)
    total = F.conv_transpose2d(x.variance, ones, None, *geometry, channels)
    met = F.conv_transpose2d(torch.ones_like(x.variance[:1, :1]), ones[:1], None, *geometry)
    around = total / met.clamp(min=1)
    variance = torch.zeros_like(mean)
    phases = (range(min(step, size)) for step, size in zip(stride, mean.shape[2:], strict=True))
    for row, column in product(*phases):
        rows = slice((row + padding[0]) % stride[0], None, stride[0])
        columns = slice((column + padding[1]) % stride[1], None, stride[1])
        together = weight[:, :, rows, columns].sum(dim=(2, 3)).square()
        place = (..., slice(row, None, stride[0]), slice(column, None, stride[1]))
        variance[place] = F.conv2d(around[place], together.t()[:, :, None, None])
    return x.like(mean, variance)


def _avg_pool2d(
    x: ChannelCorrelatedGaussian, kernel: int, stride: int, padding: int, *count: Any
) -> ChannelCorrelatedGaussian:
    """Var = (Σ√v / k²)²: deviations add up, those outside of the image being 0."""
    pooled = Gaussian.RULES[F.avg_pool2d](x, kernel, stride, padding, *count)
    return x.like(pooled.mean, F.avg_pool2d(x.variance.sqrt(), kernel, stride, padding).square())


def _dropout2d(
    x: ChannelCorrelatedGaussian, p: float, training: bool, inplace: bool = False
) -> ChannelCorrelatedGaussian:
    """Var = v / (1 − p) + m² p / (1 − p), of a factor 0 or 1 / (1 − p), in evaluation mode too."""
    odds = p / (1 - p)
    return x.like(x.mean, x.variance * (1 + odds) + x.mean.square() * odds)


ChannelCorrelatedGaussian.RULES = {
    **Gaussian.RULES,
    F.conv2d: _conv2d,
    F.conv_transpose2d: _conv_transpose2d,
    F.avg_pool2d: _avg_pool2d,
    F.dropout2d: _dropout2d,
}


def propagate_dropout(network: Network, image: RangeImage) -> Estimate:
    """Estimate what `sample` would tend to with ever more passes."""
    # The mutual information is that of a small spread of the softmax around its mean, ½ Σ v / p.
    name = f"dropout moments at {require_dropout(network.module)}"
    given = network.input(image.channels)
    moments = network.backend.run(name, _moments, given, exact=True)
    logits = ChannelCorrelatedGaussian(*moments)[..., : image.height, : image.width]
    softmax = logits.softmax(dim=1, groups=network.groups)
    mean: Double = softmax.mean[0].double().cpu().numpy()
    variance: Double = softmax.variance[0].double().cpu().numpy()
    information = (variance / np.maximum(2 * mean, MIN_MEAN)).sum(axis=0)
    total: Double = entropy(mean)
    return Estimate.of(mean, variance, total, np.minimum(information, total))


def _moments(module: SegmentationNetwork, image: Tensor) -> tuple[Tensor, Tensor]:
    """Return mean and variance of the logits of an image (B, 5, H, W), with the padding."""
    features = module.padded_trunk(image)
    certain = (ChannelCorrelatedGaussian(f, torch.zeros_like(f)) for f in features)
    logits: Any = module.rest(*certain)
    return logits.mean, logits.variance
