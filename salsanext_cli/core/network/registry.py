# SPDX-License-Identifier: MIT
"""Registry of the networks by name, as weights files and recipes give it."""

from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.network.salsanext import SalsaNext
from salsanext_cli.core.network.segmentation import SegmentationNetwork
from salsanext_cli.core.network.weights_names import PAPER_NETWORKS, paper_networks_hint
from salsanext_cli.core.plug_ins import DISTRIBUTION, PlugIn, load_plug_ins
from salsanext_cli.core.texts import error_text, shortened

NUMBERS = frozenset({"class_count", "dropout"})  # Of a network, in a weights file
ARCHITECTURES: dict[str, Callable[..., SegmentationNetwork]] = {"salsanext": SalsaNext}


@cache
def plugged_networks() -> Mapping[str, PlugIn]:
    """Return the networks of plug-ins by name."""
    return load_plug_ins("networks", ARCHITECTURES, Callable)


def plug_in_of(name: object) -> PlugIn | None:
    """Return the plug-in that a network is from; None for a built-in or unknown one."""
    return None if name in ARCHITECTURES else plugged_networks().get(str(name))


def described(name: str, **numbers: float) -> dict[str, Any]:
    """Return an architecture as weights files hold it: the name, its distribution, the numbers."""
    plug_in = plug_in_of(name)
    origin = {DISTRIBUTION: plug_in.distribution} if plug_in else {}
    return {"name": name} | origin | numbers


def build(architecture: Mapping[str, Any], source: object = "architecture") -> SegmentationNetwork:
    """Build a network.

    Parameters
    ----------
    architecture : mapping
        Name and numbers, such as ``{"name": "salsanext", "class_count": 20, "dropout": 0.2}``. The
        distribution of a plug-in only serves an error where it is not installed.
    source : object
        Origin of the architecture in errors.

    Returns
    -------
    SegmentationNetwork

    Raises
    ------
    UsageError
        If the network is unknown, or refuses the numbers.
    """
    numbers = dict(architecture)
    name = numbers.pop("name", None)
    distribution = numbers.pop(DISTRIBUTION, None)
    if not isinstance(name, str):
        raise UsageError(source, f"has the architecture {shortened(name)}", "a name")
    plug_in = plug_in_of(name)
    if name not in ARCHITECTURES and plug_in is None:
        problem = f"has the unknown architecture {shortened(name)}"
        hint = ""
        if distribution:
            problem += f" of the plug-in {shortened(distribution)}"
            hint = f"install {shortened(distribution)} in this environment"
        elif name.startswith(PAPER_NETWORKS):
            hint = paper_networks_hint()
        names = list(ARCHITECTURES) + [str(other) for other in plugged_networks().values()]
        raise UsageError(source, problem, " or ".join(names), hint)
    try:
        unknown = sorted(numbers.keys() - NUMBERS)
        if unknown:
            raise TypeError(f"no {', '.join(unknown)}")
        constructor = plug_in.target if plug_in else ARCHITECTURES[name]
        network = constructor(**numbers)
        if not isinstance(network, SegmentationNetwork):
            raise TypeError(f"a SegmentationNetwork, not a {type(network).__name__}")
    except (TypeError, ValueError) as error:
        problem = f"has the architecture {plug_in or name} with {shortened(numbers)}"
        raise UsageError(source, problem, error_text(error)) from error
    return network
