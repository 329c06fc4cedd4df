# SPDX-License-Identifier: MIT
"""What computes: the processor, what it can do, and how much of it is used."""

from __future__ import annotations

import platform
from dataclasses import dataclass
from pathlib import Path

import torch

INSTRUCTIONS = ("avx2", "avx512f", "avx512_bf16", "amx_bf16", "asimd", "bf16", "sve")
"""Of those that a processor names, the ones that decide how fast a network is on it."""


@dataclass(frozen=True, slots=True)
class Machine:
    """What a benchmark ran on.

    Attributes
    ----------
    processor : str
        Its name.
    instructions : tuple of str
        Those of `INSTRUCTIONS` that it has.
    threads : int
        How many torch uses.
    torch_version : str
        Which one.
    device : str
        Where the network was: cpu, or the name of a GPU.
    """

    processor: str
    instructions: tuple[str, ...]
    threads: int
    torch_version: str
    device: str

    @classmethod
    def here(cls, device: torch.device) -> Machine:
        """Describe this machine, as seen by this process."""
        told = _told(Path("/proc/cpuinfo"))
        flags = (told.get("flags") or told.get("Features", "")).split()
        return cls(
            processor=told.get("model name") or platform.processor() or platform.machine(),
            instructions=tuple(name for name in INSTRUCTIONS if name in flags),
            threads=torch.get_num_threads(),
            torch_version=torch.__version__,
            device=torch.cuda.get_device_name(device) if device.type == "cuda" else "cpu",
        )


def _told(path: Path) -> dict[str, str]:
    """Return what Linux says of the first processor; nothing elsewhere."""
    if not path.exists():
        return {}
    first = path.read_text("utf-8").partition("\n\n")[0]
    pairs = (line.partition(":") for line in first.splitlines())
    return {name.strip(): value.strip() for name, _, value in pairs}
