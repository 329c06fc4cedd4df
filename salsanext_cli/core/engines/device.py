# SPDX-License-Identifier: MIT
"""Choice of device and number type on this machine; torch is imported only if needed."""

import os
import platform
import sys
from functools import cache
from pathlib import Path

from salsanext_cli.core.engines.registry import LIBRARIES, computes_int8, int8_settings
from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.texts import counted
from salsanext_cli.core.wording import argument, setting

PRECISIONS = ("auto", "float32", "bfloat16", "float16", "int8")
MAX_BATCH_PIXELS = 16 * 64 * 2048  # Pixels in a batch of a GPU
GPU_FILES = ("/dev/nvidiactl", "/dev/nvidia0", "/dev/nvhost-ctrl", "/dev/kfd", "/dev/dxg")
"""Device files of Linux; without any of them torch finds no GPU."""
CPUINFO = Path("/proc/cpuinfo")
ISA_VARIABLES = ("ONEDNN_MAX_CPU_ISA", "DNNL_MAX_CPU_ISA")
BFLOAT16_ISA = {
    "amx_bf16": ("AMX", "ALL", "DEFAULT"),
    "avx512_bf16": ("BF16", "FP16", "AMX", "AVX10", "ALL", "DEFAULT"),
    "bf16": ("BF16", "FP16", "AMX", "AVX10", "ALL", "DEFAULT"),
}
"""x86 and ARM flags of bfloat16 multiplication, with the `ISA_VARIABLES` values that allow it."""
PLAIN_INT8 = "float32 and no tiles of bytes"  # On CPUs without bfloat16, and in older versions
BYTE_TILES = "amx_int8"  # x86 flag; the values that allow it are those of `amx_bf16`


def choose_device(name: str) -> str:
    """Return the device of a name: ``"cpu"``, ``"cuda"`` …; ``"auto"`` is a GPU if there is one."""
    without_gpu = sys.platform == "linux" and not any(Path(p).exists() for p in GPU_FILES)
    if name == "cpu" or (name == "auto" and without_gpu):
        return "cpu"
    import torch

    if name == "auto":
        return "cuda" if torch.cuda.is_available() else "cpu"
    try:
        device = torch.device(name)
    except RuntimeError as error:
        expected = "cpu, cuda or cuda:0 …"
        raise UsageError(argument("device"), f"unknown device {name}", expected) from error
    if device.type == "cuda":
        count = torch.cuda.device_count()
        if (device.index or 0) >= count:
            problem = f"no {name}, because torch finds {counted(count, 'GPU')}"
            raise UsageError(argument("device"), problem, hint=f"use {setting('device', 'cpu')}")
    elif device.type != "cpu":
        raise UsageError(argument("device"), f"unsupported device {name}", "cpu or cuda")
    return "cpu" if device.type == "cpu" else str(device)


def choose_precision(name: str, device: str, engine: str) -> str:
    """Return the number type of a name on a device.

    Parameters
    ----------
    name : {"auto", "float32", "bfloat16", "float16", "int8"}
        Requested number type; ``"auto"`` is the fastest float.
    device : str
        ``"cpu"``, ``"cuda"``, ``"cuda:1"`` …
    engine : str
        Library that computes, a name of `LIBRARIES`.

    Returns
    -------
    str

    Raises
    ------
    UsageError
        If the name is unknown, or device or library do not compute in it.
    """
    if name not in PRECISIONS:
        expected = ", ".join(PRECISIONS)
        raise UsageError(argument("precision"), f"unknown precision {name}", expected)
    if name == "int8":
        if not computes_int8(engine, device):
            problem = f"{engine} does not compute int8 on {device}"
            hint = f"use {int8_settings()}, or another precision"
            raise UsageError(argument("precision"), problem, hint=hint)
        return name
    library = LIBRARIES[engine]
    device_floats = floats_of_device(device)
    possible = [precision for precision in device_floats if precision in library.precisions]
    if name == "auto":
        return possible[-1]
    if name not in possible:
        lacking = library.title if name in device_floats else "this CPU"
        int8 = ["int8"] if computes_int8(engine, device) else []
        expected = " or ".join([*possible, *int8])
        raise UsageError(argument("precision"), f"{lacking} does not compute {name}", expected)
    return name


def floats_of_device(device: str) -> tuple[str, ...]:
    """Return the floats that a device computes, the fastest last."""
    if device == "cpu":
        return ("float32", "bfloat16") if bfloat16_instructions() else ("float32",)
    import torch

    if torch.cuda.get_device_capability(device) >= (7, 0):
        return ("float32", "bfloat16", "float16")
    return ("bfloat16", "float16", "float32")


@cache
def processor_flags() -> frozenset[str]:
    """Return the flags of the processor; empty on other systems than Linux."""
    text = CPUINFO.read_text("utf-8") if CPUINFO.exists() else ""
    lines = [line for line in text.splitlines() if line.startswith(("flags", "Features"))]
    return frozenset(lines[0].partition(":")[2].split() if lines else ())


def bfloat16_instructions() -> list[str]:
    """Return the flags of instructions that multiply bfloat16 and that the environment allows."""
    limit = _isa_limit()
    available = [flag for flag in BFLOAT16_ISA if flag in processor_flags()]
    return [flag for flag in available if any(part in limit for part in BFLOAT16_ISA[flag])]


def multiplies_tiles_of_bytes() -> bool:
    """Return whether the CPU multiplies tiles of bytes (AMX) and the environment allows it."""
    is_allowed = any(part in _isa_limit() for part in BFLOAT16_ISA["amx_bf16"])
    return is_allowed and BYTE_TILES in processor_flags()


def _isa_limit() -> str:
    """Return the instruction set to which the environment limits the libraries, else "ALL"."""
    named = (os.environ.get(variable) for variable in ISA_VARIABLES)
    return next(filter(None, named), "ALL").upper()


def float_of_precision(precision: str) -> str:
    """Return the float in which a CPU computes the layers that a precision leaves in floats.

    Beside layers in 8-bit integers, it is bfloat16 where the CPU multiplies it.
    """
    if precision != "int8":
        return precision
    return "bfloat16" if bfloat16_instructions() else "float32"


def int8_arithmetic() -> str:
    """Return in words what labels in int8 depend on, beside the network: they differ among CPUs."""
    tiles = "tiles of bytes" if multiplies_tiles_of_bytes() else "no tiles of bytes"
    return f"{float_of_precision('int8')} and {tiles}"


def number_type_of_labels(precision: str) -> str:
    """Return a precision as labels depend on it: in int8, CPUs of several kinds differ.

    Parameters
    ----------
    precision : str
        Number type of a network.

    Returns
    -------
    str
        The precision itself for all others, and for int8 on CPUs without more than that.
    """
    if precision != "int8":
        return precision
    arithmetic = int8_arithmetic()
    return precision if arithmetic == PLAIN_INT8 else f"{precision} with {arithmetic}"


def is_int8(number_type: object) -> bool:
    """Return whether a number type of `number_type_of_labels` is int8, on whatever CPU."""
    return str(number_type).partition(" ")[0] == "int8"


def arithmetic_in(number_type: str) -> str:
    """Return how the CPU computed int8, by a number type of `number_type_of_labels`."""
    return number_type.partition(" with ")[2] or PLAIN_INT8


def processor() -> str:
    """Return a text that identifies the instructions available to compiled code."""
    return f"{platform.machine()} {sorted(processor_flags())} {_isa_limit()}"
