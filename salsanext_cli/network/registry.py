# SPDX-License-Identifier: MIT
"""Registry of the networks by name, as weights files and recipes give it."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from salsanext_cli.errors import UsageError, error_text, shortened
from salsanext_cli.network import designs
from salsanext_cli.network.designs import Design
from salsanext_cli.network.rangenet53 import RangeNet53
from salsanext_cli.network.salsanext import SalsaNext
from salsanext_cli.network.segmentation import SegmentationNetwork

NUMBERS = frozenset({"class_count", "dropout"})
"""Numbers that a weights file may give of a network."""


def _of(design: Design) -> Callable[..., SegmentationNetwork]:
    return partial(SalsaNext, design=design)


ARCHITECTURES: dict[str, Callable[..., SegmentationNetwork]] = {
    "salsanext": _of(designs.SALSANEXT),
    "salsanext-v1": _of(designs.V1_POOLING),
    "rangenet53": RangeNet53,
    "salsanet": _of(designs.SALSANET),
    "salsanet-context": _of(designs.SALSANET_CONTEXT),
    "salsanet-dropout": _of(designs.SALSANET_DROPOUT),
    "salsanet-pooling": _of(designs.SALSANET_POOLING),
    "salsanet-dilated": _of(designs.SALSANET_DILATED),
    "salsanet-shuffle": _of(designs.SALSANEXT),
    "salsanext-v1-layers": _of(designs.V1_LAYERS),
    "salsanext-v1-context": _of(designs.V1_CONTEXT),
    "salsanext-v1-dropout": _of(designs.V1_DROPOUT),
    "salsanext-v1-pooling": _of(designs.V1_POOLING),
}
"""The last rung of either ladder changes only the loss: its network is that of the rung below."""


def build(architecture: Mapping[str, Any], source: object = "architecture") -> SegmentationNetwork:
    """Build a network from name and numbers: ``{"name": "salsanext", "class_count": 20}``."""
    numbers = dict(architecture)
    name = numbers.pop("name", None)
    if not isinstance(name, str) or name not in ARCHITECTURES:
        raise UsageError(
            source, f"architecture {shortened(name)}", f"one of {', '.join(ARCHITECTURES)}"
        )
    try:
        if unknown := sorted(numbers.keys() - NUMBERS):
            raise TypeError(f"no {', '.join(unknown)}")
        return ARCHITECTURES[name](**numbers)
    except (TypeError, ValueError) as error:
        found = f"architecture {name} with {shortened(numbers)}"
        raise UsageError(source, found, error_text(error)) from error
