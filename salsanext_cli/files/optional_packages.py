# SPDX-License-Identifier: MIT
"""Import of packages when they are first used, with a hint if that fails."""

import re
import sys
from importlib import import_module
from importlib.metadata import version
from typing import Any

from salsanext_cli.errors import MissingDependency, error_text

MIN_ROSBAGS_VERSION = (0, 11, 7)
CONVERTER = "openvino.tools.ovc"
"""Part of OpenVINO that `import openvino` imports and that reports to a server of Google."""
OPENVINO_ERRORS = (AttributeError, ImportError, OSError, RuntimeError, TypeError, ValueError)
"""Errors of damaged installations and those of another platform."""


def import_open3d() -> Any:
    """Import open3d, which takes over a second and needs a system library."""
    try:
        return import_package("open3d")
    except MissingDependency as error:
        if isinstance(error.__cause__, ModuleNotFoundError):
            raise
        expected, hint = "the system library libusb-1.0", "apt-get install libusb-1.0-0"
        raise MissingDependency("open3d", error.problem, expected, hint) from error


def import_extra(name: str, extra: str) -> Any:
    """Import a package of an extra of this one."""
    return import_package(name, f"'salsanext[{extra}]'")


def import_package(name: str, installed_with: str = "") -> Any:
    """Import a package, or raise `MissingDependency` with the command that installs it."""
    try:
        return import_module(name)
    except (ImportError, OSError) as error:
        missing = getattr(error, "name", "") in (name, name.partition(".")[0])
        problem = "is not installed" if missing else f"cannot be imported: {error}"
        hint = f"pip install {installed_with or name}"
        raise MissingDependency(name, problem, hint=hint) from error


def require_rosbags() -> None:
    """Require `rosbags` in a version that finds the clouds of single `.mcap` files."""
    import_extra("rosbags", "ros")
    installed = version("rosbags")
    if tuple(map(int, re.findall(r"\d+", installed)[:3])) < MIN_ROSBAGS_VERSION:
        expected = f"{'.'.join(map(str, MIN_ROSBAGS_VERSION))} or newer"
        hint = "pip install 'salsanext[ros]' in another environment than ouster-sdk"
        raise MissingDependency("rosbags", f"has version {installed}", expected, hint)


def import_openvino() -> Any:
    """Import OpenVINO without its converter."""
    known = CONVERTER in sys.modules
    sys.modules.setdefault(CONVERTER, None)  # type: ignore[arg-type]
    try:
        return import_module("openvino")
    except OPENVINO_ERRORS as error:
        problem = f"cannot be imported: {error_text(error)}"
        raise MissingDependency("openvino", problem, hint="install it again") from error
    finally:
        if not known:
            sys.modules.pop(CONVERTER, None)
