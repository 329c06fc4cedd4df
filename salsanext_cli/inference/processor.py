# SPDX-License-Identifier: MIT
"""Processor of this machine, as far as number types and compiled graphs depend on it."""

from __future__ import annotations

import os
import platform
from functools import cache
from pathlib import Path

CPUINFO = Path("/proc/cpuinfo")
BFLOAT16_FLAGS = {"avx512_bf16", "amx_bf16", "bf16"}
"""Flags of processors that multiply bfloat16: of x86 and of ARM."""
ISA_VARIABLE = "ONEDNN_MAX_CPU_ISA"
BFLOAT16_ISA = ("BF16", "FP16", "AMX", "AVX10", "ALL", "DEFAULT")
"""Parts of the values of `ISA_VARIABLE` that leave bfloat16 to the library."""


@cache
def flags() -> frozenset[str]:
    """Return the processor's flags; empty where the system does not tell them (not Linux)."""
    text = CPUINFO.read_text("utf-8") if CPUINFO.exists() else ""
    lines = [line for line in text.splitlines() if line.startswith(("flags", "Features"))]
    return frozenset(lines[0].split()[2:] if lines else ())


def has_bfloat16() -> bool:
    """Say whether the CPU multiplies bfloat16 by itself, and the environment allows it."""
    limit = os.environ.get(ISA_VARIABLE, "ALL").upper()
    return bool(flags() & BFLOAT16_FLAGS) and any(part in limit for part in BFLOAT16_ISA)


def processor() -> str:
    """Return what code that was compiled for this processor depends on."""
    return f"{platform.machine()} {sorted(flags())} {os.environ.get(ISA_VARIABLE, '')}"
