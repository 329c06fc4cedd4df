# SPDX-License-Identifier: MIT
"""Engine that computes with torch, on GPUs and where OpenVINO does not run.

In a shorter number type, layers that see the range image itself stay float32: eight bits of a range
are metres. So do the logits.
"""

import copy
from collections.abc import Iterator
from contextlib import contextmanager

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


class Float32Layer(nn.Module):
    """Convolution in float32, of features and into features of any type."""

    def __init__(self, layer: nn.Module, dtype: torch.dtype) -> None:
        super().__init__()
        self.layer = layer.float()
        self.dtype = dtype

    def forward(self, x: Tensor) -> Tensor:
        """Map any type to `dtype`, within its range."""
        features: Tensor = self.layer(x.float())
        if self.dtype == torch.float32:
            return features
        border = torch.finfo(self.dtype)
        return features.clamp(border.min, border.max).to(self.dtype)


def in_precision(module: SegmentationNetwork, dtype: torch.dtype) -> SegmentationNetwork:
    """Return a copy of a network that computes in a shorter type, float32 in and out."""
    short = copy.deepcopy(module).eval().to(dtype)
    for name, layer in module.named_modules():
        if not isinstance(layer, nn.Conv2d | nn.ConvTranspose2d):
            continue
        if name == LOGITS or layer.in_channels == len(CHANNELS):
            output = torch.float32 if name == LOGITS else dtype
            short.set_submodule(name, Float32Layer(copy.deepcopy(layer), output))
    return short.to(memory_format=torch.channels_last)  # type: ignore[call-overload, no-any-return]
