# SPDX-License-Identifier: MIT
"""Import of open3d when it is first used, with the remedy where that fails."""

from typing import Any

from salsanext_cli.errors import MissingDependency


def import_open3d() -> Any:
    """Import open3d, which takes over a second and needs a system library.

    Raises
    ------
    MissingDependency
        If it is not installed, or a system library is missing.
    """
    try:
        import open3d
    except ModuleNotFoundError as error:
        raise MissingDependency("open3d", "not installed", remedy="pip install open3d") from error
    except (ImportError, OSError) as error:
        raise MissingDependency(
            "open3d", str(error), "the system library libusb-1.0", "apt-get install libusb-1.0-0"
        ) from error
    return open3d
