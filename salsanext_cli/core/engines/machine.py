# SPDX-License-Identifier: MIT
"""Names and versions of what computes: packages, processor and GPU."""

import os
import platform
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, version

from salsanext_cli.core.engines.device import CPUINFO
from salsanext_cli.core.engines.registry import library_packages

NAME_KEYS = ("model name", "Model", "Hardware")  # Of the processor, of x86 and of ARM


def version_of(package: str) -> str | None:
    """Return the version of an installed package, None without one."""
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def versions(packages: Iterable[str]) -> dict[str, str | None]:
    """Return the version of Python and of packages by name."""
    return {"python": platform.python_version()} | {name: version_of(name) for name in packages}


def computing_packages() -> tuple[str, ...]:
    """Return the packages whose version may change a label."""
    return (*library_packages(), "numpy", "numba")


def processor_name() -> str:
    """Return the name of the processor, of its kind if the system does not state it."""
    return name_in(CPUINFO.read_text("utf-8") if CPUINFO.exists() else "")


def name_in(cpuinfo: str) -> str:
    """Return the name that a content of Linux's `cpuinfo` states, else the kind of processor."""
    named = dict(line.split(":", 1) for line in cpuinfo.splitlines() if ":" in line)
    fields = {key.strip(): value.strip() for key, value in named.items()}
    stated = (fields.get(key) for key in NAME_KEYS)
    return next(filter(None, stated), platform.processor() or platform.machine())


def gpu_name(device: str) -> str | None:
    """Return the name of the GPU of a device such as ``"cuda:0"``, None for ``"cpu"``."""
    if device == "cpu":
        return None
    import torch

    return torch.cuda.get_device_name(device)


def machine(device: str) -> dict[str, object]:
    """Return system, processor, cores and GPU of this machine as plain data."""
    return {
        "system": platform.platform(),
        "cpu": processor_name(),
        "cores": os.cpu_count(),
        "gpu": gpu_name(device),
    }
