# SPDX-License-Identifier: MIT
"""What the network computes in while it trains: a recipe's word, and what it means on a device."""

from __future__ import annotations

import torch

AMPERE = 8
"""The first generation of GPUs that computes in bfloat16, by its compute capability."""
DTYPES = {"float32": torch.float32, "bfloat16": torch.bfloat16, "float16": torch.float16}


def dtype_of(precision: str, device: torch.device) -> torch.dtype:
    """Return the type behind a recipe's `precision` on a device.

    "auto" is float32 on every CPU, so that a training does not depend on which one it is; on GPUs
    it is bfloat16, or float16 on those too old for it.
    """
    if precision != "auto":
        return DTYPES[precision]
    if device.type != "cuda":
        return torch.float32
    generation, _ = torch.cuda.get_device_capability(device)
    return torch.bfloat16 if generation >= AMPERE else torch.float16


def autocast(dtype: torch.dtype, device: torch.device) -> torch.autocast:
    """Return the context in which convolutions compute in a type; of float32 it does nothing."""
    shorter = dtype is not torch.float32
    return torch.autocast(device.type, dtype if shorter else torch.bfloat16, enabled=shorter)


def scaler(dtype: torch.dtype, device: torch.device) -> torch.amp.GradScaler:
    """Return what keeps small gradients from vanishing in float16; otherwise it does nothing."""
    return torch.amp.GradScaler(device.type, enabled=dtype is torch.float16)
