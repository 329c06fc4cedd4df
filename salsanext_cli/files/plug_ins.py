# SPDX-License-Identifier: MIT
"""Plug-ins: objects of other distributions, which their entry points name."""

import hashlib
import logging
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from salsanext_cli.errors import error_text, warn_once

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class PlugIn:
    """Object of another distribution.

    Attributes
    ----------
    name : str
        Name of the entry point.
    distribution : str
        Name and version of the distribution, such as ``radian-lidar 1.0``.
    module : str
        Module that the entry point names.
    target : Any
        The object.
    """

    name: str
    distribution: str
    module: str
    target: Any

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


Fault = Callable[[Any, Mapping[str, PlugIn]], str]
"""Function of an object and the plug-ins accepted so far that returns what is wrong with it."""


def load_plug_ins(kind: str, built_in: Collection[str], fault: Fault) -> dict[str, PlugIn]:
    """Import the plug-ins of a kind; log one warning for each that cannot be used.

    Parameters
    ----------
    kind : str
        Group of entry points without ``salsanext.``: formats, networks or label_spaces.
    built_in : collection of str
        Names that a plug-in cannot have.
    fault : callable
        Check of the objects.

    Returns
    -------
    dict of str to PlugIn
        By name, sorted.
    """
    from importlib.metadata import entry_points

    accepted: dict[str, PlugIn] = {}
    points = entry_points(group=f"salsanext.{kind}")
    for point in sorted(points, key=lambda point: (point.name, _distribution(point))):
        plug_in, problem = None, ""
        if point.name in built_in:
            problem = "a built-in one has this name"
        elif point.name in accepted:
            problem = f"{accepted[point.name].distribution} has one of this name"
        else:
            try:
                plug_in = PlugIn(point.name, _distribution(point), point.module, point.load())
                problem = fault(plug_in.target, accepted)
            except Exception as error:  # noqa: BLE001 - a module may raise anything
                problem = f"its import fails: {type(error).__name__}: {error_text(error)}"
        if problem or plug_in is None:
            subject = f"{point.name} ({_distribution(point)}) in salsanext.{kind}"
            warn_once(log, f"plug-in {subject} is not used: {problem}")
        else:
            accepted[plug_in.name] = plug_in
    return accepted


def _distribution(point: Any) -> str:
    return f"{point.dist.name} {point.dist.version}"
