# SPDX-License-Identifier: MIT
"""A class and an uncertainty for every point of a LiDAR scan.

The names in `__all__` are public. A name is imported at its first use, so that importing the
package, and printing the help of the command line, takes no time.
"""

from __future__ import annotations

from salsanext_cli.core import caches
from salsanext_cli.io.user_caches import UserCaches
from salsanext_cli.version import __version__

caches.use(UserCaches())

TYPE_CHECKING = False  # Importing it from `typing` takes time.
if TYPE_CHECKING:
    from typing import Any

    from salsanext_cli.api import label, label_drive
    from salsanext_cli.core.classes.label_space import LabelSpace
    from salsanext_cli.core.engines.network import Network
    from salsanext_cli.core.errors import SalsanextError
    from salsanext_cli.core.geometry.knn import knn_refine
    from salsanext_cli.core.geometry.knn_parameters import KnnParameters
    from salsanext_cli.core.geometry.projection import project
    from salsanext_cli.core.records import RangeImage, Scan
    from salsanext_cli.core.sensors.sensor import Sensor
    from salsanext_cli.core.uncertainty.monte_carlo import sample
    from salsanext_cli.io.formats import read_scan
    from salsanext_cli.io.formats.kitti_labels import read_labels, write_labels
    from salsanext_cli.io.formats.ply import write_ply
    from salsanext_cli.io.label_spaces import label_space
    from salsanext_cli.io.sensors import sensor
    from salsanext_cli.io.weights.loading import load_network
    from salsanext_cli.runs.fit.sensor_fit import fit_network

__all__ = [
    "KnnParameters",
    "LabelSpace",
    "Network",
    "RangeImage",
    "SalsanextError",
    "Scan",
    "Sensor",
    "__version__",
    "fit_network",
    "knn_refine",
    "label",
    "label_drive",
    "label_space",
    "load_network",
    "project",
    "read_labels",
    "read_scan",
    "sample",
    "sensor",
    "write_labels",
    "write_ply",
]

_HOMES = {
    "api": ("label", "label_drive"),
    "core.classes.label_space": ("LabelSpace",),
    "core.engines.network": ("Network",),
    "core.errors": ("SalsanextError",),
    "core.geometry.knn": ("knn_refine",),
    "core.geometry.projection": ("project",),
    "core.records": ("RangeImage", "Scan"),
    "core.sensors.sensor": ("Sensor",),
    "core.uncertainty.monte_carlo": ("sample",),
    "io.formats": ("read_scan",),
    "io.formats.kitti_labels": ("read_labels", "write_labels"),
    "io.formats.ply": ("write_ply",),
    "io.label_spaces": ("label_space",),
    "io.sensors": ("sensor",),
    "io.weights.loading": ("load_network",),
    "runs.fit.sensor_fit": ("fit_network",),
    "core.geometry.knn_parameters": ("KnnParameters",),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> Any:
    """Import a public name from its module."""
    import importlib

    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(f"{__name__}.{_HOME_OF[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
