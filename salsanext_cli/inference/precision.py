# SPDX-License-Identifier: MIT
"""Number type that a network computes in, chosen from what the processor is fast at."""

from __future__ import annotations

import torch

from salsanext_cli.errors import UsageError

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
    if name == "auto":
        return _fastest(device)
    if name == "float16" and device.type == "cpu":
        raise UsageError("--precision", "float16 on a CPU", "float32 or bfloat16, or a GPU")
    return name


def _fastest(device: torch.device) -> str:
    if device.type == "cuda":
        return "float16" if torch.cuda.get_device_capability(device) >= (7, 0) else "float32"
    has_tiles = getattr(torch.cpu, "_is_amx_tile_supported", lambda: False)
    return "bfloat16" if has_tiles() else "float32"
