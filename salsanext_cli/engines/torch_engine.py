# SPDX-License-Identifier: MIT
"""Engine that computes with torch, on GPUs and where OpenVINO does not run.

In a shorter number type, layers that see the range image itself stay float32: eight bits of a range
are metres. So do the logits.
"""

import copy
from collections.abc import Iterator
from contextlib import contextmanager
from typing import cast

import torch
from torch import Tensor, nn

from salsanext_cli.engines.graphs import LOGITS
from salsanext_cli.network.segmentation import SegmentationNetwork
from salsanext_cli.records import CHANNELS


@contextmanager
def inference_mode(device: str) -> Iterator[None]:
    """Set torch up: no gradients; on a GPU the same bits always, and all those of float32."""
    cudnn = {"enabled": True, "benchmark": False, "deterministic": True, "allow_tf32": False}
    with torch.inference_mode():
        if device == "cpu":
            yield
        else:
            with torch.cuda.device(device), torch.backends.cudnn.flags(**cudnn):
                yield


class Float32Convolution(nn.Conv2d):
    """Convolution in float32, of features and into features of any type; autocast leaves it."""

    output: torch.dtype = torch.float32

    def forward(self, x: Tensor) -> Tensor:
        """Map (B, in, H, W) of any type to (B, out, H, W) of `output`, within its range."""
        with torch.autocast(x.device.type, enabled=False):
            features: Tensor = super().forward(x.float())
        if self.output == torch.float32:
            return features
        border = torch.finfo(self.output)
        return features.clamp(border.min, border.max).to(self.output)


def keep_ends_in_float32(module: nn.Module, hidden: torch.dtype = torch.float32) -> None:
    """Let the layers of the range image, into features of a type, and of the logits be float32."""
    for name, layer in module.named_modules():
        if type(layer) is nn.Conv2d and (name == LOGITS or layer.in_channels == len(CHANNELS)):
            # The same tensors under the same names; a new layer would need copies of them.
            layer.__class__ = Float32Convolution
            cast(Float32Convolution, layer).output = torch.float32 if name == LOGITS else hidden


def in_precision(module: SegmentationNetwork, dtype: torch.dtype) -> SegmentationNetwork:
    """Return a copy of a network that computes in a shorter type, float32 in and out."""
    short = copy.deepcopy(module).eval()
    keep_ends_in_float32(short, dtype)
    for layer in short.modules():
        if not isinstance(layer, Float32Convolution) and not [*layer.children()]:
            layer.to(dtype)
    return short.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
