# SPDX-License-Identifier: MIT
"""Choice of precision and engine: the same weights in the arithmetic the device is fast at.

In a shorter number type, layers that see the range image itself stay float32: eight bits of a range
are metres. So do the logits.
"""

import copy

import torch
from torch import Tensor, nn

from salsanext_cli.errors import UsageError
from salsanext_cli.network.segmentation import SegmentationNetwork
from salsanext_cli.records import CHANNELS

PRECISIONS = ("auto", "float32", "bfloat16", "float16")
LOGITS = "logits"
"""The name of the last layer, in every architecture."""


def choose_precision(name: str, device: torch.device) -> str:
    """Return the number type of a name on a device.

    Parameters
    ----------
    name : {"auto", "float32", "bfloat16", "float16"}
        ``"auto"`` is float16 on a GPU with tensor cores, bfloat16 on a CPU with tiles for it (AMX),
        and float32 elsewhere: other CPUs gain less from short numbers than from `winograd`.
    device : torch.device
        Place of the network.

    Raises
    ------
    UsageError
        If there is no such type, or a CPU is asked for float16, in which it would also sum up.
    """
    if name not in PRECISIONS:
        raise UsageError("--precision", name, ", ".join(PRECISIONS))
    if name == "float16" and device.type == "cpu":
        raise UsageError("--precision", "float16 on a CPU", "float32 or bfloat16, or a GPU")
    if name != "auto":
        return name
    if device.type == "cuda":
        return "float16" if torch.cuda.get_device_capability(device) >= (7, 0) else "float32"
    has_tiles = getattr(torch.cpu, "_is_amx_tile_supported", lambda: False)
    return "bfloat16" if has_tiles() else "float32"


def engine_for(
    module: SegmentationNetwork, device: torch.device, precision: str
) -> SegmentationNetwork:
    """Return a network for inference that computes what `module` does in evaluation mode.

    Parameters
    ----------
    module : SegmentationNetwork
        On the device; it stays as it is. Later changes of its weights are not followed.
    device : torch.device
        CPU or GPU.
    precision : {"float32", "bfloat16", "float16"}
        As `choose_precision` returns it.
    """
    if precision != "float32":
        return in_precision(module, getattr(torch, precision))
    if device.type == "cpu" and all(p.dtype == torch.float32 for p in module.parameters()):
        from salsanext_cli.inference.fused import fuse

        return fuse(module)
    return module


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
