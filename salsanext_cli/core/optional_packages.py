# SPDX-License-Identifier: MIT
"""Import of packages when they are first used, with a hint if that fails."""

import json
import re
import shlex
from contextlib import suppress
from importlib import import_module
from importlib.metadata import PackageNotFoundError, distribution, version
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit
from urllib.request import url2pathname

from salsanext_cli.core.errors import MissingDependency
from salsanext_cli.core.interruptions import require_no_interruption

NAME = "salsanext"
OWN_DISTRIBUTIONS = {"paper": "examples/paper_networks"}
"""Folder, in a clone, of the distribution that an extra installs from the package index."""
MIN_ROSBAGS_VERSION = (0, 11, 7)


def import_open3d() -> Any:
    """Import open3d, which takes over a second and needs a system library."""
    try:
        return import_package("open3d")
    except MissingDependency as error:
        if isinstance(error.__cause__, ModuleNotFoundError):
            raise
        expected = "the system library libusb-1.0"
        hint = "apt-get install libusb-1.0-0"
        raise MissingDependency("open3d", error.problem, expected, hint) from error


def import_extra(name: str, extra: str) -> Any:
    """Import a package of an extra of this one."""
    return import_package(name, extra_command(extra))


def extra_command(extra: str) -> str:
    """Return the command that installs an extra, into an installation from a clone too."""
    with suppress(PackageNotFoundError, TypeError, ValueError, KeyError):
        # Installers record a folder that they installed from (PEP 610).
        source = json.loads(distribution(NAME).read_text("direct_url.json") or "{}")
        clone = Path(url2pathname(urlsplit(source["url"]).path))
        if "dir_info" in source and (clone / "pyproject.toml").is_file():
            if extra in OWN_DISTRIBUTIONS:
                return f"pip install {shlex.quote(str(clone / OWN_DISTRIBUTIONS[extra]))}"
            editable = "-e " if source["dir_info"].get("editable") else ""
            return f"pip install {editable}{shlex.quote(f'{clone}[{extra}]')}"
    in_clone = OWN_DISTRIBUTIONS.get(extra, f"'.[{extra}]'")
    return f"pip install '{NAME}[{extra}]', or in a clone: pip install {in_clone}"


def import_package(name: str, command: str = "") -> Any:
    """Import a package, or raise `MissingDependency` with the command that installs it."""
    try:
        return import_module(name)
    except (ImportError, OSError) as error:
        require_no_interruption(error)
        missing = getattr(error, "name", "") in (name, name.partition(".")[0])
        problem = "is not installed" if missing else f"cannot be imported: {error}"
        hint = command or f"pip install {name}"
        raise MissingDependency(name, problem, hint=hint) from error


def require_rosbags() -> None:
    """Require `rosbags` in a version that finds the clouds of single `.mcap` files."""
    import_extra("rosbags", "ros")
    installed = version("rosbags")
    if tuple(map(int, re.findall(r"\d+", installed)[:3])) < MIN_ROSBAGS_VERSION:
        expected = f"{'.'.join(map(str, MIN_ROSBAGS_VERSION))} or newer"
        hint = f"in another environment than ouster-sdk: {extra_command('ros')}"
        raise MissingDependency("rosbags", f"has version {installed}", expected, hint)
