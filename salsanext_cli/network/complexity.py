# SPDX-License-Identifier: MIT
"""Parameters, multiply-accumulates and receptive fields of the networks."""

from __future__ import annotations

import copy

import torch
from torch import Tensor, nn

from salsanext_cli.network.segmentation import SegmentationNetwork
from salsanext_cli.records import CHANNELS

RECEPTIVE_FIELDS = {
    "salsanext": (425, 425),
    "salsanext-v1": (543, 543),
    "rangenet53": (71, 853),
    "salsanet": (267, 267),
    "salsanet-context": (285, 285),
    "salsanet-dropout": (285, 285),
    "salsanet-pooling": (285, 285),
    "salsanet-dilated": (425, 425),
    "salsanet-shuffle": (425, 425),
    "salsanext-v1-layers": (539, 539),
    "salsanext-v1-context": (543, 543),
    "salsanext-v1-dropout": (543, 543),
    "salsanext-v1-pooling": (543, 543),
}
"""Height and width of the window of the image that a pixel's logits depend on, by architecture; the
largest, where it differs between the pixels of a cell of the coarsest level."""


def parameter_count(module: nn.Module) -> int:
    """Return the number of trainable numbers in a network."""
    return sum(parameter.numel() for parameter in module.parameters())


def multiply_accumulates(module: SegmentationNetwork, height: int = 64, width: int = 2048) -> int:
    """Count the multiply-accumulates of one range image, convolutions only; nothing is computed."""
    counts: list[int] = []

    def count(layer: nn.Module, inputs: tuple[Tensor], output: Tensor) -> None:
        # Every weight meets every pixel once: of the output, or of what is spread out.
        pixels = (inputs[0] if isinstance(layer, nn.ConvTranspose2d) else output).shape[-2:]
        counts.append(layer.get_parameter("weight").numel() * pixels.numel())

    copied = copy.deepcopy(module).to("meta").eval()
    for layer in copied.modules():
        if isinstance(layer, nn.Conv2d | nn.ConvTranspose2d):
            layer.register_forward_hook(count)
    copied(torch.empty(1, len(CHANNELS), height, width, device="meta"))
    return sum(counts)
