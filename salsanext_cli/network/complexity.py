# SPDX-License-Identifier: MIT
"""Parameters, multiply-accumulates and receptive fields of the networks."""

from __future__ import annotations

import copy

import torch
from torch import nn
from torch.utils.flop_counter import FlopCounterMode

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
    copied = copy.deepcopy(module).to("meta").eval()
    with FlopCounterMode(display=False) as counter, torch.no_grad():
        copied(torch.empty(1, len(CHANNELS), height, width, device="meta"))
    operations: int = counter.get_total_flops()
    return operations // 2
