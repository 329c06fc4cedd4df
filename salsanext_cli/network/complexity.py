# SPDX-License-Identifier: MIT
"""Costs of the networks."""

import copy
from dataclasses import dataclass

import torch
from torch import nn
from torch.utils.flop_counter import FlopCounterMode

from salsanext_cli.network.segmentation import SegmentationNetwork
from salsanext_cli.records import CHANNELS


@dataclass(frozen=True, slots=True)
class NetworkCosts:
    """Costs of a network on one range image."""

    name: str
    parameters: int
    multiply_accumulates: int


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
