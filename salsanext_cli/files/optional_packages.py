# SPDX-License-Identifier: MIT
"""Import of packages when they are first used, with the hint where that fails."""

import re
import sys
from importlib import import_module
from importlib.metadata import version
from typing import Any

from salsanext_cli.errors import MissingDependency, error_text

MIN_ROSBAGS_VERSION = (0, 11)
CONVERTER = "openvino.tools.ovc"
"""Part of OpenVINO that `import openvino` imports, and that then reports to a server of Google."""
OPENVINO_ERRORS = (AttributeError, ImportError, OSError, RuntimeError, TypeError, ValueError)
"""Raised by installations that are damaged or of another platform."""


def import_open3d() -> Any:
    """Import open3d, which takes over a second and needs a system library."""
    try:
        import open3d
    except ModuleNotFoundError as error:
        raise MissingDependency("open3d", "not installed", hint="pip install open3d") from error
    except (ImportError, OSError) as error:
        raise MissingDependency(
            "open3d", str(error), "the system library libusb-1.0", "apt-get install libusb-1.0-0"
        ) from error
    return open3d


def import_extra(name: str, extra: str) -> Any:
    """Import a package that comes with an extra of this one."""
    return import_package(name, f"'salsanext[{extra}]'")


def import_package(name: str, installed_with: str = "") -> Any:
    """Import a package; an error says what to install."""
    try:
        return import_module(name)
    except ImportError as error:
        missing = error.name in (name, name.partition(".")[0])
        found = "not installed" if missing else f"cannot be imported: {error}"
        hint = f"pip install {installed_with or name}"
        raise MissingDependency(name, found, hint=hint) from error


def require_rosbags() -> None:
    """Require `rosbags` in a version that reads single files of a ROS 2 bag."""
    import_extra("rosbags", "ros")
    found = version("rosbags")
    if tuple(map(int, re.findall(r"\d+", found)[:2])) < MIN_ROSBAGS_VERSION:
        expected = f"{'.'.join(map(str, MIN_ROSBAGS_VERSION))} or newer"
        hint = "pip install 'salsanext[ros]', in another environment than ouster-sdk"
        raise MissingDependency("rosbags", f"version {found}", expected, hint)


def import_openvino() -> Any:
    """Import OpenVINO without its converter."""
    known = CONVERTER in sys.modules
    sys.modules.setdefault(CONVERTER, None)  # type: ignore[arg-type]
    try:
        return import_module("openvino")
    except OPENVINO_ERRORS as error:
        found = f"cannot be imported: {error_text(error)}"
        raise MissingDependency("openvino", found, hint="install it again") from error
    finally:
        if not known:
            sys.modules.pop(CONVERTER, None)
