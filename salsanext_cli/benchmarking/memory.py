# SPDX-License-Identifier: MIT
"""The most memory that this process took, since it was last asked to forget."""

from __future__ import annotations

from pathlib import Path

import torch

PROCESS = Path("/proc/self")


def forget_peak(device: torch.device) -> None:
    """Count the most memory anew, where that can be; elsewhere it is that of the whole process."""
    if device.type == "cuda":
        torch.cuda.reset_peak_memory_stats(device)
    try:
        (PROCESS / "clear_refs").write_text("5", "ascii")
    except OSError:
        return


def peak_memory(device: torch.device) -> tuple[int | None, int | None]:
    """Return the most bytes of this process and of the GPU; None where there is none to ask."""
    on_device = torch.cuda.max_memory_allocated(device) if device.type == "cuda" else None
    status = PROCESS / "status"
    if not status.exists():
        return None, on_device
    told = dict(line.split(":", 1) for line in status.read_text("utf-8").splitlines())
    return int(told["VmHWM"].split()[0]) * 1024, on_device
