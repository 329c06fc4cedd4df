# SPDX-License-Identifier: MIT
"""Versions, device and extras, as bug reports need them."""

import platform
import re
from collections.abc import Iterator
from importlib.metadata import requires

from salsanext_cli.version import __version__

OTHER_PACKAGES = ("open3d", "typer")
INSTRUCTIONS = ("avx2", "avx_vnni", "avx512f", "avx512_vnni", "avx512_bf16", "amx_int8", "amx_bf16")
EXTRA = re.compile(r"""(?P<package>[\w.-]+).*;.*extra == ["'](?P<extra>\w+)["']""")
NOT_LISTED = {"dev", "docs"}


def version_lines() -> Iterator[str]:
    """Yield a line for each package, the device, the instructions of the CPU, and the extras."""
    from salsanext_cli.core.engines.device import choose_device, processor_flags
    from salsanext_cli.core.engines.machine import computing_packages, processor_name, version_of

    yield f"salsanext {__version__}"
    yield f"Python {platform.python_version()} on {platform.platform()}"
    for name in (*computing_packages(), *OTHER_PACKAGES):
        yield f"{name} {version_of(name) or 'is not installed'}"
    yield f"device: {choose_device('auto')}"
    yield f"CPU: {processor_name()}"
    instructions = [name for name in INSTRUCTIONS if name in processor_flags()]
    yield f"instructions: {', '.join(instructions) or 'others'}"
    yield f"extras: {', '.join(_installed_extras()) or 'none'}"


def _installed_extras() -> list[str]:
    """Return the extras of which every package is installed."""
    from salsanext_cli.core.engines.machine import version_of

    packages: dict[str, list[str]] = {}
    requirements = requires("salsanext") if version_of("salsanext") else None
    for text in requirements or ():
        match = EXTRA.match(text)
        if match and match["extra"] not in NOT_LISTED:
            packages.setdefault(match["extra"], []).append(match["package"])
    return [extra for extra, names in packages.items() if all(map(version_of, names))]
