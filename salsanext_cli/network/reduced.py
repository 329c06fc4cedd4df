# SPDX-License-Identifier: MIT
"""The same network in a shorter number type, but for its ends.

Layers that see the range image itself stay float32: eight bits of a range are metres. So do the
logits.
"""

from __future__ import annotations

import copy

import torch
from torch import Tensor, nn

from salsanext_cli.network.segmentation import SegmentationNetwork
from salsanext_cli.records import CHANNELS

LOGITS = "logits"
"""The name of the last layer, in every architecture."""


class FirstLayer(nn.Module):
    """A float32 convolution of the range image; its output is of the shorter type."""

    def __init__(self, layer: nn.Conv2d, dtype: torch.dtype) -> None:
        super().__init__()
        self.layer = layer
        self.dtype = dtype

    def forward(self, x: Tensor) -> Tensor:
        """Map float32 to the shorter type; what is beyond its range becomes its border."""
        border = torch.finfo(self.dtype)
        features: Tensor = self.layer(x)
        return features.clamp(border.min, border.max).to(self.dtype)


class LastLayer(nn.Module):
    """A float32 convolution of features of the shorter type."""

    def __init__(self, layer: nn.Conv2d) -> None:
        super().__init__()
        self.layer = layer

    def forward(self, x: Tensor) -> Tensor:
        """Map the shorter type to float32; what has overflowed becomes finite."""
        logits: Tensor = self.layer(x.float())
        return logits.nan_to_num()


def reduced(module: SegmentationNetwork, dtype: torch.dtype) -> SegmentationNetwork:
    """Return a copy of a network that computes in a shorter type, float32 in and out."""
    found = copy.deepcopy(module).eval()
    ends = {
        name: layer
        for name, layer in found.named_modules()
        if isinstance(layer, nn.Conv2d) and (layer.in_channels == len(CHANNELS) or name == LOGITS)
    }
    found.to(dtype)
    for name, layer in ends.items():
        layer.float()
        wrapped = LastLayer(layer) if name == LOGITS else FirstLayer(layer, dtype)
        found.set_submodule(name, wrapped)
    return found.to(memory_format=torch.channels_last)  # type: ignore[call-overload, no-any-return]
