# SPDX-License-Identifier: MIT
"""Dark figures with colour bars and legends, whose text can be read on a telephone."""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import numpy.typing as npt

from pictures.rendering import BACKGROUND
from pictures.shrink import shrink
from salsanext_cli.report.colours import RIGHT, WRONG, Colours, Legend, value_colours

mpl.use("Agg")

from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D


def share_of_colour(rgb: tuple[int, int, int]) -> tuple[float, float, float]:
    """Return red, green and blue, 0 to 255, as shares, 0 to 1."""
    red, green, blue = rgb
    return red / 255, green / 255, blue / 255


WIDTH_PX, DOTS = 1000, 100
"""Width of a figure, which a telephone shows with 390 pixels, and its dots per inch."""
TEXT_PT = 19
"""Size of text: 10 pixels where 390 pixels show the figure."""
BAR_CELLS = 256
SMALL = 0.005
"""Marks below this are shown as powers of ten."""
DARK = share_of_colour(BACKGROUND)
INK = "#e6e6e6"
GREY = share_of_colour(RIGHT)
RED = share_of_colour(WRONG)
ORANGE, GREEN, FAINT = "#ff9d3b", "#3fbf6f", "#2b2e36"

Values = npt.NDArray[Any]


def sheet(height: float) -> Figure:
    """Return an empty dark figure of a height in inches."""
    return Figure(figsize=(WIDTH_PX / DOTS, height), facecolor=DARK, layout="constrained")


def panels(figure: Figure | SubFigure, rows: int, columns: int, **options: Any) -> list[Axes]:
    """Return axes without ticks, row by row."""
    axes: list[Axes] = figure.subplots(rows, columns, squeeze=False, **options).ravel().tolist()
    for axis in axes:
        axis.set_facecolor(DARK)
        axis.set_xticks([])
        axis.set_yticks([])
        axis.spines[:].set_visible(False)
        for label in (axis.xaxis.label, axis.yaxis.label):
            label.set_color(INK)
            label.set_fontsize(TEXT_PT)
        axis.tick_params(colors=INK, labelsize=TEXT_PT)
    return axes


def titled(axis: Axes, text: str) -> None:
    """Put a title above axes."""
    axis.set_title(text, fontsize=TEXT_PT, color=INK)


def save(figure: Figure, picture: Path) -> None:
    """Write a figure as WebP."""
    png = BytesIO()
    figure.savefig(png, format="png", dpi=DOTS)
    png.seek(0)
    shrink(png, picture, WIDTH_PX)


def colour_bar(axis: Axes, marks: Sequence[float], colour_map: Colours | None = None) -> None:
    """Fill axes with a colour bar that has a tick at each mark; the marks have equal distances."""
    values = np.interp(np.linspace(0, 1, BAR_CELLS), np.linspace(0, 1, len(marks)), marks)
    strip = value_colours(values, *marks, colour_map=colour_map)[None]
    axis.imshow(strip, aspect="auto", extent=(0, len(marks) - 1, 0, 1))
    axis.set_xticks(range(len(marks)), [mark_name(mark) for mark in marks])
    axis.tick_params(axis="x", colors=INK, labelsize=TEXT_PT - 1, length=5)


def mark_name(mark: float) -> str:
    """Return a number as text; a small one as a power of ten."""
    if 0 < mark < SMALL:
        return f"$10^{{{round(np.log10(mark))}}}$"
    return f"{mark:g}"


def legend(figure: Figure | SubFigure, entries: Legend, columns: int) -> None:
    """Put names with their colours below the axes of a figure."""
    handles = [
        Line2D([], [], linestyle="", marker="s", markersize=13, color=share_of_colour(colour))
        for _, colour in entries
    ]
    box = figure.legend(
        handles,
        [name for name, _ in entries],
        loc="outside lower center",
        ncols=columns,
        fontsize=TEXT_PT - 1,
        frameon=False,
        handletextpad=0.2,
        columnspacing=1.0,
    )
    for text in box.get_texts():
        text.set_color(INK)


def from_above(
    axis: Axes,
    points: Values,
    colours: Values,
    centre: tuple[float, float],
    reach: tuple[float, float],
    size: float,
) -> None:
    """Draw points from above, x to the right.

    Parameters
    ----------
    axis : Axes
        Where to draw.
    points, colours : (N, 3) float
        Points in metres, and their colours from 0 to 1. Later points cover earlier ones.
    centre, reach : tuple of float
        Point in the middle, and distance from it to the right and to the upper edge, in metres.
    size : float
        Area of a point in square points of the figure.
    """
    across = points[:, 0] - centre[0]
    up = points[:, 1] - centre[1]
    near = (abs(across) < reach[0]) & (abs(up) < reach[1])
    axis.scatter(across[near], up[near], s=size, c=colours[near], linewidths=0)
    axis.set_aspect("equal")
    axis.set_xlim(-reach[0], reach[0])
    axis.set_ylim(-reach[1], reach[1])
