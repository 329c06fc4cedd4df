# SPDX-License-Identifier: MIT
"""What a network costs: parameters and multiply-accumulates, counted."""

from __future__ import annotations

import torch
from torch import nn
from torch.utils.flop_counter import FlopCounterMode

from salsanext_cli.records import CHANNELS


def parameter_count(module: nn.Module) -> int:
    """Return the number of trainable numbers in a network."""
    return sum(parameter.numel() for parameter in module.parameters())


def multiply_accumulates(module: nn.Module, height: int = 64, width: int = 2048) -> int:
    """Count the multiply-accumulates of one range image, convolutions only.

    Runs the network on torch's meta device, where shapes flow but nothing is computed; the
    module is moved there, so pass one that is not needed any more.
    """
    image = torch.empty(1, len(CHANNELS), height, width, device="meta")
    with FlopCounterMode(display=False) as counter:
        module.to("meta").eval()(image)
    return int(counter.get_total_flops()) // 2
