# SPDX-License-Identifier: MIT
"""Registry of the networks by name, as weights files and recipes give it."""

from collections.abc import Callable, Mapping
from functools import cache, partial
from typing import Any

from salsanext_cli.errors import UsageError, error_text, shortened
from salsanext_cli.files.plug_ins import DISTRIBUTION, PlugIn, load_plug_ins
from salsanext_cli.network import salsanext
from salsanext_cli.network.rangenet53 import RangeNet53
from salsanext_cli.network.segmentation import SegmentationNetwork

NUMBERS = frozenset({"class_count", "dropout"})  # Of a network, in a weights file


def _of(design: salsanext.Design) -> Callable[..., SegmentationNetwork]:
    return partial(salsanext.SalsaNext, design=design)


ARCHITECTURES: dict[str, Callable[..., SegmentationNetwork]] = {
    "salsanext": _of(salsanext.SALSANEXT),
    "salsanext-v1": _of(salsanext.V1_POOLING),
    "rangenet53": RangeNet53,
    "salsanet": _of(salsanext.SALSANET),
    "salsanet-context": _of(salsanext.SALSANET_CONTEXT),
    "salsanet-dropout": _of(salsanext.SALSANET_DROPOUT),
    "salsanet-pooling": _of(salsanext.SALSANET_POOLING),
    "salsanet-dilated": _of(salsanext.SALSANET_DILATED),
    "salsanet-shuffle": _of(salsanext.SALSANEXT),
    "salsanext-v1-layers": _of(salsanext.V1_LAYERS),
    "salsanext-v1-context": _of(salsanext.V1_CONTEXT),
    "salsanext-v1-dropout": _of(salsanext.V1_DROPOUT),
    "salsanext-v1-pooling": _of(salsanext.V1_POOLING),
}
"""The last rung of either ladder changes only the loss: its network is that of the rung below."""


@cache
def plugged_networks() -> Mapping[str, PlugIn]:
    """Return the networks of plug-ins by name."""
    return load_plug_ins("networks", ARCHITECTURES, Callable)


def plug_in_of(architecture: Mapping[str, Any]) -> PlugIn | None:
    """Return the plug-in that an architecture is of; None for a built-in or unknown one."""
    name = str(architecture.get("name"))
    return None if name in ARCHITECTURES else plugged_networks().get(name)


def described(name: str, **numbers: float) -> dict[str, Any]:
    """Return an architecture as weights files hold it: the name, its distribution, the numbers."""
    plug_in = plug_in_of({"name": name})
    return {"name": name, **({DISTRIBUTION: plug_in.distribution} if plug_in else {}), **numbers}


def build(architecture: Mapping[str, Any], source: object = "architecture") -> SegmentationNetwork:
    """Build a network.

    Parameters
    ----------
    architecture : mapping
        Name and numbers, such as ``{"name": "salsanext", "class_count": 20, "dropout": 0.2}``. The
        distribution of a plug-in only serves an error where it is not installed.
    source : object
        Subject of errors.

    Raises
    ------
    UsageError
        If there is no such network, or it does not take the numbers.
    """
    numbers = dict(architecture)
    name, distribution = numbers.pop("name", None), numbers.pop(DISTRIBUTION, None)
    plug_in = plug_in_of(architecture)
    if not isinstance(name, str) or (name not in ARCHITECTURES and plug_in is None):
        found, hint = f"architecture {shortened(name)}", ""
        if distribution:
            found += f" of the plug-in {shortened(distribution)}, which is not installed"
            hint = f"install {shortened(distribution)} in this environment"
        known = (*ARCHITECTURES, *map(str, plugged_networks().values()))
        raise UsageError(source, found, f"one of {', '.join(known)}", hint)
    try:
        if unknown := sorted(numbers.keys() - NUMBERS):
            raise TypeError(f"no {', '.join(unknown)}")
        network = (plug_in.target if plug_in else ARCHITECTURES[name])(**numbers)
        if not isinstance(network, SegmentationNetwork):
            raise TypeError(f"a SegmentationNetwork, not a {type(network).__name__}")
    except (TypeError, ValueError) as error:
        found = f"architecture {plug_in or name} with {shortened(numbers)}"
        raise UsageError(source, found, error_text(error)) from error
    return network
