# SPDX-License-Identifier: MIT
"""A network in a shorter number type, all but its first and last layers.

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


class Float32Accumulation(nn.Module):
    """Convolution that sums up in float32, of features and into features of any type."""

    def __init__(self, layer: nn.Module, dtype: torch.dtype) -> None:
        super().__init__()
        self.layer = layer.float()
        self.dtype = dtype

    def forward(self, x: Tensor) -> Tensor:
        """Map any type to `dtype`; what is beyond the range of a shorter one becomes its border."""
        features: Tensor = self.layer(x.float())
        if self.dtype == torch.float32:
            return features
        border = torch.finfo(self.dtype)
        return features.clamp(border.min, border.max).to(self.dtype)


def in_precision(module: SegmentationNetwork, dtype: torch.dtype) -> SegmentationNetwork:
    """Return a copy of a network that computes in a shorter type, float32 in and out.

    Where the processor has no instructions for the type, convolutions sum up in float32, as
    processors that have them do: torch would round at every step there, and take ten times as long.
    """
    found = copy.deepcopy(module).eval().to(dtype)
    native = has_instructions(next(module.parameters()).device, dtype)
    for name, layer in module.named_modules():
        if not isinstance(layer, nn.Conv2d | nn.ConvTranspose2d):
            continue
        if name == LOGITS or layer.in_channels == len(CHANNELS):
            output = torch.float32 if name == LOGITS else dtype
            found.set_submodule(name, Float32Accumulation(copy.deepcopy(layer), output))
        elif not native:
            found.set_submodule(name, Float32Accumulation(found.get_submodule(name), dtype))
    return found.to(memory_format=torch.channels_last)  # type: ignore[call-overload, no-any-return]


def has_instructions(device: torch.device, dtype: torch.dtype) -> bool:
    """Say whether a processor multiplies a type by itself; GPUs do, or torch sums up as they do."""
    if device.type != "cpu":
        return True
    name = {torch.bfloat16: "_is_mkldnn_bf16_supported"}.get(dtype, "_is_mkldnn_fp16_supported")
    return bool(getattr(torch.ops.mkldnn, name)())
