# SPDX-License-Identifier: MIT
"""Choice of precision and engine: the same weights in the arithmetic the device is fast at."""

from __future__ import annotations

import torch

from salsanext_cli.errors import UsageError
from salsanext_cli.inference.mixed_precision import in_precision
from salsanext_cli.network.segmentation import SegmentationNetwork

PRECISIONS = ("auto", "float32", "bfloat16", "float16")


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
