# SPDX-License-Identifier: MIT
"""Titles, a legend of classes and a colour bar, for the panels of an animation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from pictures.rendering import BACKGROUND
from salsanext_cli.report.colours import Legend, value_colours

INK = (235, 235, 235)
TITLE_PX = 27
TEXT_PX = 22
ROW_PX = 34
MARGIN_PX = 6
SWATCH_PX = 18
TICK_PX = 6


def title(text: str, width: int) -> Image.Image:
    """Return a line with a title."""
    picture = Image.new("RGB", (width, ROW_PX), BACKGROUND)
    draw = ImageDraw.Draw(picture)
    draw.text((MARGIN_PX, 2), text, INK, ImageFont.load_default(TITLE_PX))
    return picture


def legend(classes: Legend, width: int, columns: int) -> Image.Image:
    """Return names of classes with their colours, row by row."""
    rows = -(-len(classes) // columns)
    picture = Image.new("RGB", (width, rows * ROW_PX), BACKGROUND)
    draw = ImageDraw.Draw(picture)
    font = ImageFont.load_default(TEXT_PX)
    for number, (name, colour) in enumerate(classes):
        left = MARGIN_PX + number % columns * (width - MARGIN_PX) // columns
        top = number // columns * ROW_PX + (ROW_PX - SWATCH_PX) // 2
        draw.rectangle((left, top, left + SWATCH_PX, top + SWATCH_PX), colour)
        draw.text((left + SWATCH_PX + 6, top - 5), name, INK, font)
    return picture


def colour_bar(marks: Sequence[float], names: Sequence[str], width: int) -> Image.Image:
    """Return a colour bar with a tick and a name at each mark; the marks have equal distances."""
    picture = Image.new("RGB", (width, 2 * ROW_PX), BACKGROUND)
    draw = ImageDraw.Draw(picture)
    font = ImageFont.load_default(TEXT_PX)
    left = 4 * MARGIN_PX
    length = width - 2 * left
    share = np.linspace(0, 1, length)
    values = np.interp(share, np.linspace(0, 1, len(marks)), marks)
    strip = np.repeat(value_colours(values, *marks)[None], SWATCH_PX, axis=0)
    picture.paste(Image.fromarray(strip), (left, MARGIN_PX))
    bottom = MARGIN_PX + SWATCH_PX
    for number, name in enumerate(names):
        x = left + number * (length - 1) // (len(names) - 1)
        draw.line((x, bottom, x, bottom + TICK_PX), INK, 2)
        draw.text((x, bottom + TICK_PX), name, INK, font, anchor="ma")
    return picture


def below_each_other(parts: Sequence[Image.Image]) -> Image.Image:
    """Put pictures of one width below each other."""
    sheet = np.vstack([np.asarray(part) for part in parts])
    return Image.fromarray(sheet)
