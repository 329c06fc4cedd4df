# SPDX-License-Identifier: MIT
"""Strips of a range image below each other: range, intensity, labels, errors, uncertainty."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.geometry.gather import pixels_from_points
from salsanext_cli.records import RangeImage
from salsanext_cli.report import canvas
from salsanext_cli.report.canvas import MARGIN_PX
from salsanext_cli.report.colours import (
    COLOUR_MAP,
    EMPTY,
    Colours,
    Legend,
    map_colours,
    value_colours,
    value_range,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TITLE_PX = 34
"""Pixels above each strip for its title."""
BAR_PX = 130
"""Pixels beside the strips for colour bars and their numbers."""
STRIP_WIDTH_PX = 2048
STRIP_HEIGHT_PX = 192
"""Least size of a strip in pixels: 64 rows are drawn three times as high as they are."""


@dataclass(frozen=True, slots=True)
class Strip:
    """A picture of a range image with its title, and a colour bar if it shows values.

    Attributes
    ----------
    title : str
        Text above the picture.
    picture : (H, W, 3) uint8
        Red, green, blue of every pixel; row 0 is the highest beam.
    scale : pair of float, optional
        Values at the ends of its colour bar.
    unit : str
        Unit of these values.
    """

    title: str
    picture: Colours
    scale: tuple[float, float] | None = None
    unit: str = ""


def coloured_strip(image: RangeImage, title: str, colours: Colours) -> Strip:
    """Return a strip of the colours of points, (N, 3)."""
    return Strip(title, pixels_from_points(colours, image.point_of_pixel, EMPTY))


def range_strip(image: RangeImage) -> Strip:
    """Return a strip of the distance of every pixel, from 0 m."""
    return scalar_strip(image, "range", image.channels[0], "m", 0.0)


def scalar_strip(
    image: RangeImage,
    title: str,
    values: npt.NDArray[Any],
    unit: str = "",
    lowest: float | None = None,
) -> Strip:
    """Return a strip of values of pixels (H, W) or points (N,); the scale spans most of them."""
    filled = image.point_of_pixel >= 0
    pixels = values if values.ndim == 2 else pixels_from_points(values, image.point_of_pixel)
    low, high = value_range(pixels[filled])
    low = low if lowest is None else lowest
    empty = np.array(EMPTY, np.uint8)
    colours = np.where(filled[..., None], value_colours(pixels, low, high), empty)
    return Strip(title, colours, (low, high), unit)


def panel(path: Path, strips: Sequence[Strip], legend: Legend = ()) -> None:
    """Draw strips below each other, with titles, colour bars and a legend, as a PNG.

    Parameters
    ----------
    path : Path
        The file to write.
    strips : sequence of Strip
        From top to bottom.
    legend : list of (name, colour)
        Entries of the legend below them.
    """
    pictures = [_enlarged(strip.picture) for strip in strips]
    width = max(picture.shape[1] for picture in pictures)
    body = sum(picture.shape[0] + TITLE_PX for picture in pictures)
    size = (MARGIN_PX + width + BAR_PX, body + MARGIN_PX)
    figure = canvas.new_picture(*size, legend, width)
    top = 0
    for strip, picture in zip(strips, pictures, strict=True):
        canvas.text_at(figure, MARGIN_PX, top + TITLE_PX // 2 + 2, strip.title, 18)
        top += TITLE_PX
        height = picture.shape[0]
        canvas.show_pixels(figure, picture, MARGIN_PX, top, picture.shape[1], height)
        if strip.scale:
            _draw_bar(figure, strip.scale, strip.unit, MARGIN_PX + width + 16, top, height)
        top += height
    canvas.save_png(figure, path)


def _enlarged(picture: Colours) -> Colours:
    """Enlarge a picture to a legible size by repeating its pixels."""
    rows = max(1, round(STRIP_HEIGHT_PX / picture.shape[0]))
    columns = max(1, round(STRIP_WIDTH_PX / picture.shape[1]))
    return picture.repeat(rows, axis=0).repeat(columns, axis=1)


def _draw_bar(
    figure: Figure, scale: tuple[float, float], unit: str, left: int, top: int, height: int
) -> None:
    low, high = scale
    rows = np.linspace(255, 0, height).round().astype(np.intp)
    canvas.show_pixels(figure, map_colours(COLOUR_MAP)[rows][:, None], left, top, 16, height)
    # Digits by the span of the scale: its lower end is "0" rather than "0.00035".
    digits = 2 - math.floor(math.log10(max(high - low, 1e-9)))
    for value, place in ((high, 9), ((low + high) / 2, height // 2), (low, height - 9)):
        text = f"{round(value, digits):.4g} {unit}".strip()
        canvas.text_at(figure, left + 24, top + place, text, 15)
