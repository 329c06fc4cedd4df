# SPDX-License-Identifier: MIT
"""Figures measured in pixels, without pyplot's global state: axes, text, legend, PNG files."""

from __future__ import annotations

import warnings
from collections.abc import Container
from io import BytesIO
from typing import TYPE_CHECKING, Any, Literal

from salsanext_cli.report.colours import EMPTY, Colours, Legend

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DPI = 100
PAPER = "white"
NIGHT = "#" + bytes(value // 2 for value in EMPTY).hex()
"""Background of pictures of scans: darker than `EMPTY`, so that strips have an edge."""
INK = "#e8e8ea"
FAINT = "#8a8f98"
DIM = "#5d626b"
"""Colours of text, grid lines and secondary text on `NIGHT`."""
DARK = "#22262c"
PALE = "#c9ced6"
"""Colours of text and grid lines on `PAPER`."""
MARGIN_PX = 28
LEGEND_STEP_PX = 165
LEGEND_ROW_PX = 26
SWATCH_PX = (22, 14)


def new_figure(width: int, height: int, background: str = NIGHT) -> Figure:
    """Return an empty figure of a size in pixels."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width / DPI, height / DPI), dpi=DPI, facecolor=background)


def new_picture(
    width: int, height: int, legend: Legend, legend_width: int, absent: Container[str] = ()
) -> Figure:
    """Return an empty figure above a legend; sizes in pixels, absent entries faint."""
    columns = max(1, legend_width // LEGEND_STEP_PX)
    rows = -(-len(legend) // columns)
    legend_height = rows * LEGEND_ROW_PX + MARGIN_PX if legend else 0
    figure = new_figure(width, height + legend_height)
    for i, (name, colour) in enumerate(legend):
        left = MARGIN_PX + i % columns * LEGEND_STEP_PX
        top = height + i // columns * LEGEND_ROW_PX
        if name not in absent:
            _show_swatch(figure, colour, left, top + 3)
        text_at(figure, left + 30, top + 10, name, 15, DIM if name in absent else INK)
    return figure


def _show_swatch(figure: Figure, colour: tuple[int, int, int], left: int, top: int) -> None:
    """Fill a rectangle; separate axes for each entry of a legend would take most of the time."""
    from matplotlib.patches import Rectangle

    width, height = figure.get_size_inches() * DPI
    corner = left / width, 1 - (top + SWATCH_PX[1]) / height
    filled = Rectangle(
        corner,
        width=SWATCH_PX[0] / width,
        height=SWATCH_PX[1] / height,
        transform=figure.transFigure,
        linewidth=0,
    )
    filled.set(facecolor=[value / 255 for value in colour], antialiased=False)
    figure.add_artist(filled)


def show_pixels(
    figure: Figure, picture: Colours, left: int, top: int, width: int, height: int
) -> None:
    """Show a picture (H, W, 3), stretched to a size in pixels, at a position of a figure."""
    axes = axes_at(figure, left, top, width, height)
    axes.set_axis_off()
    axes.imshow(picture, aspect="auto", interpolation="nearest")


def axes_at(figure: Figure, left: int, top: int, width: int, height: int) -> Axes:
    """Add axes at a position in pixels from the upper left corner."""
    across, down = figure.get_size_inches() * DPI
    bottom = down - top - height
    return figure.add_axes((left / across, bottom / down, width / across, height / down))


def text_at(figure: Figure, left: int, top: int, text: str, size: int, colour: str = INK) -> None:
    """Write plain text with its middle at `top`, in pixels from the upper left corner."""
    width, height = figure.get_size_inches() * DPI
    style: dict[str, Any] = {"fontsize": size * 72 / DPI, "color": colour, "parse_math": False}
    figure.text(left / width, 1 - top / height, text, va="center_baseline", **style)


def new_plot(
    width: int, height: int, place: tuple[int, int, int, int], title: str = ""
) -> tuple[Figure, Axes]:
    """Return a figure on `PAPER` and its axes: left, top, width and height, all in pixels."""
    figure = new_figure(width, height, PAPER)
    text_at(figure, place[0], 25, title, 17, DARK)
    return figure, axes_at(figure, *place)


def plain_frame(axes: Axes, grid: Literal["both", "x"] | None = "both") -> None:
    """Remove the box and the ticks; draw a thin grid behind the data."""
    if grid:
        axes.grid(axis=grid, color=PALE, linewidth=0.6)
        axes.set_axisbelow(True)
    axes.tick_params(which="both", length=0, colors=DARK, labelsize=10)
    for side in axes.spines.values():
        side.set_visible(False)


def png_of(figure: Figure) -> bytes:
    """Return a figure as the content of a PNG file."""
    png = BytesIO()
    with warnings.catch_warnings():
        # The font lacks some scripts, whose letters are drawn as boxes.
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        figure.savefig(png, format="png", dpi=DPI, metadata={"Software": None})
    return png.getvalue()
