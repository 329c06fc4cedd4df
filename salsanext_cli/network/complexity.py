# SPDX-License-Identifier: MIT
"""What a network costs: parameters and multiply-accumulates, counted."""

from __future__ import annotations

from typing import Any

from torch import nn

from salsanext_cli.network.receptive_field import Reach
from salsanext_cli.network.segmentation import SegmentationNetwork


def parameter_count(module: nn.Module) -> int:
    """Return the number of trainable numbers in a network."""
    return sum(parameter.numel() for parameter in module.parameters())


def multiply_accumulates(module: SegmentationNetwork, height: int = 64, width: int = 2048) -> int:
    """Count the multiply-accumulates of one range image, convolutions only.

    Nothing is computed: what flows through the network knows its size and no numbers.
    """
    counts: list[int] = []

    def count(layer: nn.Module, inputs: tuple[Any, ...], output: Any) -> None:
        # Every weight meets every pixel once: of what comes out, or of what is spread out.
        spread = isinstance(layer, nn.ConvTranspose2d)
        rows, columns = (inputs[0] if spread else output).shape
        counts.append(next(layer.parameters()).numel() * rows * columns)

    layers = [m for m in module.modules() if isinstance(m, nn.Conv2d | nn.ConvTranspose2d)]
    hooks = [layer.register_forward_hook(count) for layer in layers]
    size = (-(-n // step) * step for n, step in zip((height, width), module.stride, strict=True))
    image: Any = Reach.of(*size)
    module.rest(*module.trunk(image))
    for hook in hooks:
        hook.remove()
    return sum(counts)
