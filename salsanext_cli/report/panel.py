# SPDX-License-Identifier: MIT
"""Strips of a range image below each other: range, intensity, labels, errors, uncertainty."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from salsanext_cli.geometry.projection import pixels_from_points
from salsanext_cli.records import RangeImage
from salsanext_cli.report import canvas
from salsanext_cli.report.canvas import MARGIN_PX
from salsanext_cli.report.colours import (
    EMPTY,
    Colours,
    map_on_dark,
    value_colours,
    value_range,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TITLE_PX = 34
"""Pixels above each strip for its title."""
BAR_PX = 160
"""Pixels beside the strips for colour bars and their numbers."""
STRIP_HEIGHT_PX = 128
"""Height of a strip: 64 rows are drawn twice as high as they are."""


@dataclass(frozen=True, slots=True)
class Strip:
    """A picture of a range image with its title, and a colour bar if it shows values."""

    title: str  # Text above the picture
    picture: Colours  # (H, W, 3) uint8: red, green, blue of every pixel; row 0 is the highest beam
    scale: tuple[float, float] | None = None  # Values at the ends of its colour bar
    unit: str = ""  # Unit of these values


def coloured_strip(image: RangeImage, title: str, colours: Colours) -> Strip:
    """Return a strip of the colours of points, (N, 3)."""
    return Strip(title, pixels_from_points(colours, image.point_of_pixel, EMPTY))


def range_strip(image: RangeImage) -> Strip:
    """Return a strip of the distance of every pixel, from 0 m to that of most."""
    filled = (image.point_of_pixel >= 0)[..., None]
    _, high = value_range(image.channels[0][filled[..., 0]])
    colours = np.where(
        filled, value_colours(image.channels[0], 0.0, high), np.array(EMPTY, np.uint8)
    )
    return Strip("range", colours, (0.0, high), "m")


def draw_strips(figure: Figure, strips: Sequence[Strip], top: int, width: int) -> None:
    """Draw strips below each other, with titles and colour bars, from `MARGIN_PX` on the left.

    `strips`: from top to bottom; each takes `TITLE_PX` and `STRIP_HEIGHT_PX`; `top`: place of the
    first title, in pixels; `width`: width of a strip in pixels; `BAR_PX` on its right are for the
    bar.
    """
    for strip in strips:
        canvas.text_at(figure, MARGIN_PX, top + TITLE_PX // 2 + 2, strip.title, 18)
        top += TITLE_PX
        canvas.show_pixels(figure, strip.picture, MARGIN_PX, top, width, STRIP_HEIGHT_PX)
        if strip.scale:
            left = MARGIN_PX + width + 16
            _draw_bar(figure, strip.scale, strip.unit, left, top, STRIP_HEIGHT_PX)
        top += STRIP_HEIGHT_PX


def _draw_bar(
    figure: Figure, scale: tuple[float, float], unit: str, left: int, top: int, height: int
) -> None:
    low, high = scale
    rows = np.linspace(255, 0, height).round().astype(np.intp)
    canvas.show_pixels(figure, map_on_dark()[rows][:, None], left, top, 16, height)
    # Digits by the span of the scale: its lower end is "0" rather than "0.00035".
    digits = 2 - math.floor(math.log10(max(high - low, 1e-9)))
    for value, place in ((high, 9), ((low + high) / 2, height // 2), (low, height - 9)):
        text = f"{round(value, digits):.4g} {unit}".strip()
        canvas.text_at(figure, left + 24, top + place, text, 15)
