# SPDX-License-Identifier: MIT
"""Copies of tensors to a device, which the host does not wait for."""

import torch
from torch import Tensor


def to_device(tensor: Tensor, device: torch.device) -> Tensor:
    """Return a tensor on a device; the copy to a GPU does not wait, since memory is pinned."""
    source = tensor if device.type == "cpu" else tensor.pin_memory()
    return source.to(device, non_blocking=True)
