# SPDX-License-Identifier: MIT
"""Which images of a batch bring a training to a halt."""

from __future__ import annotations

import copy
from itertools import compress

import torch
from torch import Tensor, nn


@torch.no_grad()
def non_finite_samples(
    module: nn.Module, loss: nn.Module, images: Tensor, truth: Tensor
) -> list[int]:
    """Return the places in a batch of the images whose loss, each alone, is not finite.

    Each is normalised by its own statistics: the running ones may be spoilt by now.

    Parameters
    ----------
    module, loss
        What was trained; neither changes.
    images : (B, 5, H, W) float32
        Or whatever else the module takes.
    truth : (B, H, W) uint8
    """
    probe = copy.deepcopy(module).eval()
    for norm in probe.modules():
        if isinstance(norm, nn.modules.batchnorm._BatchNorm):
            norm.running_mean = norm.running_var = None
    # Each twice: an image may have a single pixel at the coarsest level, and one has no statistics.
    losses = (
        loss(probe(torch.stack(2 * [image])), torch.stack(2 * [labels]))
        for image, labels in zip(images, truth, strict=True)
    )
    bad = [not bool(torch.isfinite(each)) for each in losses]
    return list(compress(range(len(bad)), bad))
