# SPDX-License-Identifier: MIT
"""Choice of the engine: the same weights in the arithmetic that the device is fast at."""

from __future__ import annotations

import torch

from salsanext_cli.inference.mixed_precision import in_precision
from salsanext_cli.network.segmentation import SegmentationNetwork


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
        As `precision.choose_precision` returns it.
    """
    if precision != "float32":
        return in_precision(module, getattr(torch, precision))
    if device.type == "cpu" and all(p.dtype == torch.float32 for p in module.parameters()):
        from salsanext_cli.inference.fused import fuse

        return fuse(module)
    return module
