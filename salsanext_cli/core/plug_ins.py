# SPDX-License-Identifier: MIT
"""Plug-ins: objects of other distributions, found by their entry points."""

import hashlib
import logging
from collections.abc import Callable, Collection
from dataclasses import dataclass
from importlib.util import find_spec
from multiprocessing import current_process
from operator import attrgetter
from pathlib import Path
from typing import Any

from salsanext_cli.core.errors import error_text, warn_once

DISTRIBUTION = "distribution"
"""Key of the plug-in's distribution in the description of a network in weights files."""

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class PlugIn:
    """Object of another distribution."""

    name: str  # Name of the entry point
    distribution: str  # Name and version, such as radian-lidar 1.0
    module: str  # Module that the entry point names
    target: Any  # The object

    def __str__(self) -> str:
        return f"{self.name} ({self.distribution})"

    def digest(self) -> str:
        """Return a digest of the source files of the plug-in's package."""
        spec = find_spec(self.module.partition(".")[0])
        folders = (spec and spec.submodule_search_locations) or ()
        files = sorted(file for folder in folders for file in Path(folder).rglob("*.py"))
        digest = hashlib.sha256()
        for file in files or ([Path(spec.origin)] if spec and spec.origin else []):
            digest.update(file.read_bytes())
        return digest.hexdigest()


def load_plug_ins(
    kind: str,
    built_in: Collection[str],
    expected: Any,
    fault: Callable[[Any, Collection[PlugIn]], str] = lambda *_: "",
) -> dict[str, PlugIn]:
    """Import the plug-ins of a kind, by name of their entry point, sorted; warn of unusable ones.

    `kind`: group of entry points without ``salsanext.``, such as formats; `built_in`: names that a
    plug-in cannot have; `expected`: type of the objects; `fault`: function of an object and the
    earlier plug-ins that returns a problem with the object, or "".
    """
    from importlib.metadata import entry_points

    accepted: dict[str, PlugIn] = {}
    points = entry_points(group=f"salsanext.{kind}")
    for point in sorted(points, key=attrgetter("name", "dist.name")):
        dist: Any = point.dist
        distribution = f"{dist.name} {dist.version}"
        problem = "the name is taken" if point.name in {*built_in, *accepted} else ""
        try:
            if not problem:
                target = point.load()
                problem = f"it is a {type(target).__name__}, not a {expected.__name__}"
                if isinstance(target, expected):
                    problem = fault(target, accepted.values())
        except (KeyboardInterrupt, MemoryError):
            raise
        except BaseException as error:  # noqa: BLE001 - a module may raise anything, or exit
            problem = f"{type(error).__name__}: {error_text(error)}"
        if problem and current_process().name == "MainProcess":  # Not again in each worker
            warn_once(log, f"plug-in {point.name} ({distribution}) is not used: {problem}")
        elif not problem:
            accepted[point.name] = PlugIn(point.name, distribution, point.module, target)
    return accepted
