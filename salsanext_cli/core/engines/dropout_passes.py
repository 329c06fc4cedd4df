# SPDX-License-Identifier: MIT
"""Passes of the part of a network behind its first dropout, in torch, for every library."""

from collections.abc import Sequence

import torch
from torch import Tensor

from salsanext_cli.core.network.dropout import sampling
from salsanext_cli.core.network.segmentation import SegmentationNetwork


def softmax_and_entropy(logits: Tensor) -> tuple[Tensor, Tensor]:
    """Return softmax (B, C, H, W) and entropy (B, H, W), nats, of logits."""
    softmax = logits.softmax(dim=1)
    logarithm = logits.log_softmax(dim=1)
    return softmax, -(softmax * logarithm).sum(dim=1)


def rest_with_factors(module: SegmentationNetwork, *inputs: Tensor) -> tuple[Tensor, Tensor]:
    """Return softmax and entropy from features (B, C, H, W) and factors of channels (B, C)."""
    features = [tensor for tensor in inputs if tensor.dim() == 4]
    factors = (tensor for tensor in inputs if tensor.dim() == 2)
    with sampling(lambda *_: next(factors)):
        return softmax_and_entropy(module.rest(*features))


@torch.inference_mode()
def dropout_rates(
    module: SegmentationNetwork, features: Sequence[Tensor]
) -> list[tuple[int, float]]:
    """Return channels and rate of each dropout behind features, in the order of computation."""
    rates: list[tuple[int, float]] = []

    def draw(channels: int, rate: float) -> Tensor:
        rates.append((channels, rate))
        return torch.ones(1, channels)

    with sampling(draw):
        module.rest(*features)
    return rates


def dropout_factors(module: SegmentationNetwork, features: Sequence[Tensor]) -> list[Tensor]:
    """Return factors (1, C) of 1 for each dropout, in the order of computation."""
    return [torch.ones(1, channels) for channels, _ in dropout_rates(module, features)]
