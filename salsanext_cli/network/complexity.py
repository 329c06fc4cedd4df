# SPDX-License-Identifier: MIT
"""Parameters and multiply-accumulates of a network."""

from __future__ import annotations

import copy

import torch
from torch import nn
from torch.utils.flop_counter import FlopCounterMode

from salsanext_cli.network.segmentation import SegmentationNetwork
from salsanext_cli.records import CHANNELS


def parameter_count(module: nn.Module) -> int:
    """Return the number of trainable numbers in a network."""
    return sum(parameter.numel() for parameter in module.parameters())


def multiply_accumulates(module: SegmentationNetwork, height: int = 64, width: int = 2048) -> int:
    """Count the multiply-accumulates of one range image, convolutions only; nothing is computed."""
    image = torch.empty(1, len(CHANNELS), height, width, device="meta")
    with FlopCounterMode(display=False) as counter:
        copy.deepcopy(module).to("meta").eval()(image)
    operations: int = counter.get_total_flops()
    return operations // 2
