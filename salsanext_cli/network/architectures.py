# SPDX-License-Identifier: MIT
"""Networks by name, so that a weights file can say which one it belongs to."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from salsanext_cli.errors import UsageError
from salsanext_cli.network.salsanext import SalsaNext

ARCHITECTURES: dict[str, Callable[..., SalsaNext]] = {"salsanext": SalsaNext}


def build(architecture: Mapping[str, Any], source: object = "architecture") -> SalsaNext:
    """Build a network from its name and numbers, e.g. ``{"name": "salsanext", "class_count": 20}``.

    Raises
    ------
    UsageError
        If the name is unknown or a number does not fit; `source` is named.
    """
    numbers = dict(architecture)
    name = numbers.pop("name", None)
    if not isinstance(name, str) or name not in ARCHITECTURES:
        raise UsageError(source, f"architecture {name}", f"one of {', '.join(ARCHITECTURES)}")
    try:
        return ARCHITECTURES[name](**numbers)
    except (TypeError, ValueError) as error:
        raise UsageError(source, f"architecture {name} with {numbers}", str(error)) from error
