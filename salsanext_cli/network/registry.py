# SPDX-License-Identifier: MIT
"""Registry of the networks by name, as weights files and recipes give it."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from salsanext_cli.errors import UsageError, error_text, shortened
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


def build(architecture: Mapping[str, Any], source: object = "architecture") -> SegmentationNetwork:
    """Build a network from name and numbers: ``{"name": "salsanext", "class_count": 20}``."""
    numbers = dict(architecture)
    name = numbers.pop("name", None)
    if not isinstance(name, str) or name not in ARCHITECTURES:
        expected = f"one of {', '.join(ARCHITECTURES)}"
        raise UsageError(source, f"architecture {shortened(name)}", expected)
    try:
        if unknown := sorted(numbers.keys() - NUMBERS):
            raise TypeError(f"no {', '.join(unknown)}")
        return ARCHITECTURES[name](**numbers)
    except (TypeError, ValueError) as error:
        found = f"architecture {name} with {shortened(numbers)}"
        raise UsageError(source, found, error_text(error)) from error
