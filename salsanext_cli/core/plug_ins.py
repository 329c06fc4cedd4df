# SPDX-License-Identifier: MIT
"""Plug-ins: objects of other distributions, found by their entry points."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Callable, Collection
from dataclasses import dataclass
from importlib.util import find_spec
from multiprocessing import current_process
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

from salsanext_cli.core.interruptions import require_no_interruption
from salsanext_cli.core.notices import warn_once
from salsanext_cli.core.texts import error_text

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

DISTRIBUTION = "distribution"
"""Key of the plug-in's distribution in the description of a network in weights files."""

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
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


Fault = Callable[[Any, Collection[PlugIn]], str]


def no_fault(target: Any, earlier: Collection[PlugIn]) -> str:
    """Return no problem with an object."""
    return ""


def load_plug_ins(
    kind: str, built_in: Collection[str], expected: Any, fault: Fault = no_fault
) -> dict[str, PlugIn]:
    """Import the plug-ins of a kind, and warn of unusable ones.

    Parameters
    ----------
    kind : str
        Group of entry points without ``salsanext.``, such as formats.
    built_in : collection of str
        Names that a plug-in cannot have.
    expected : type
        Type of the objects.
    fault : callable
        Returns a problem with an object beside the earlier plug-ins, or an empty text.

    Returns
    -------
    dict of str to PlugIn
        Usable plug-ins by name of their entry point, sorted.
    """
    from importlib.metadata import entry_points

    accepted: dict[str, PlugIn] = {}
    points = entry_points(group=f"salsanext.{kind}")
    for point in sorted(points, key=attrgetter("name", "dist.name")):
        try:
            if point.name in built_in or point.name in accepted:
                raise _UnusablePlugInError("the name is taken")
            accepted[point.name] = _loaded_plug_in(point, expected, fault, accepted.values())
        except _UnusablePlugInError as error:
            if current_process().name == "MainProcess":  # Not again in each worker
                named = f"plug-in {point.name} ({_distribution_of(point)})"
                warn_once(log, f"{named} is not used: {error}")
    return accepted


def plug_in_packages() -> list[str]:
    """Return the names of all distributions with plug-ins, sorted, also of unusable ones."""
    from importlib.metadata import entry_points

    groups = [group for group in entry_points().groups if group.startswith("salsanext.")]
    distributions: list[Any] = [
        point.dist for group in groups for point in entry_points(group=group)
    ]
    return sorted({distribution.name for distribution in distributions})


class _UnusablePlugInError(Exception):
    """A plug-in cannot be used; the text states why."""


def _loaded_plug_in(
    point: EntryPoint, expected: Any, fault: Fault, earlier: Collection[PlugIn]
) -> PlugIn:
    """Import the plug-in of an entry point, and check its object."""
    try:
        target = point.load()
        if not isinstance(target, expected):
            kinds = f"it is a {type(target).__name__}, not a {expected.__name__}"
            raise _UnusablePlugInError(kinds)
        problem = fault(target, earlier)
    except (KeyboardInterrupt, MemoryError, _UnusablePlugInError):
        raise
    except BaseException as error:  # a module may raise anything, or exit
        require_no_interruption(error)
        text = f"{type(error).__name__}: {error_text(error)}"
        raise _UnusablePlugInError(text) from error
    if problem:
        raise _UnusablePlugInError(problem)
    return PlugIn(
        name=point.name, distribution=_distribution_of(point), module=point.module, target=target
    )


def _distribution_of(point: EntryPoint) -> str:
    """Return name and version of the distribution of an entry point."""
    distribution: Any = point.dist
    return f"{distribution.name} {distribution.version}"
