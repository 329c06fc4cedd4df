# SPDX-License-Identifier: MIT
"""Colours of classes as numbers."""

from salsanext_cli.io.label_spaces import label_space

SPACE = label_space()
CAR, ROAD = SPACE.names.index("car"), SPACE.names.index("road")


def rgb(colour: str) -> list[int]:
    """Return red, green and blue, 0…255, of a colour such as `#ff8000`."""
    return [int(colour[i : i + 2], 16) for i in (1, 3, 5)]
