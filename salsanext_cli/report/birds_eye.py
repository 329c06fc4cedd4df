# SPDX-License-Identifier: MIT
"""Scans seen from above."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from salsanext_cli.records import Float
from salsanext_cli.report import canvas
from salsanext_cli.report.colours import EMPTY, Colours

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

OVERSAMPLING = 2
TITLE_PX = 40
REACH_M = 45.0
"""Distance from the sensor to the edge of a view."""
GRID_M = 10.0
"""Metres between two circles."""


def raster(points: Float, colours: Colours, reach: float, size: int, spread: int = 1) -> Colours:
    """Draw points as seen from above; a higher point hides a lower one.

    `points` (N, 3) float32, metres, sensor frame: x forward, y left, z up. NaN and infinity are
    left out; `colours` (N, 3) uint8, red, green, blue of every point; `reach`: distance in metres
    from the sensor, in the middle, to an edge; `size`: height and width in pixels; `spread`: height
    and width of a point in pixels.

    Returns (size, size, 3) uint8, x points up, y to the left.
    """
    finite = np.flatnonzero(np.isfinite(points).all(axis=1))
    order = finite[np.argsort(points[finite, 2], kind="stable")]
    corner = np.floor((reach - points[order, :2].astype(np.float64)) * size / (2 * reach))
    inside = ((corner > -spread) & (corner < size)).all(axis=1)
    row, column = corner[inside].astype(np.intp).T
    picture = np.full((size + 2 * spread, size + 2 * spread, 3), EMPTY, np.uint8)
    # All offsets of one point before the next point: a higher one stays whole.
    across, down = np.meshgrid(np.arange(spread), np.arange(spread))
    rows = (row[:, None] + down.ravel() + spread).ravel()
    columns = (column[:, None] + across.ravel() + spread).ravel()
    picture[rows, columns] = colours[order][inside].repeat(spread**2, axis=0)
    return picture[spread : size + spread, spread : size + spread]


def draw_view(
    figure: Figure, points: Float, title: str, colours: Colours, left: int, top: int, size: int
) -> None:
    """Draw a scan from above at a place of a figure, with circles every `GRID_M` metres.

    `points` (N, 3) float32, metres, sensor frame; `title`: text above the view, `TITLE_PX` high;
    `colours` (N, 3) uint8, red, green, blue of every point; `left`, `top`: place of its upper left
    corner, in pixels; `size`: height and width of the view below the title, in pixels.
    """
    canvas.text_at(figure, left, top + TITLE_PX // 2, title, 18)
    axes = canvas.axes_at(figure, left, top + TITLE_PX, size, size)
    _draw(axes, _smooth(points, colours, size))


def _smooth(points: Float, colours: Colours, size: int) -> Colours:
    """Draw larger and average down, so that edges of points are soft."""
    large = raster(points, colours, REACH_M, size * OVERSAMPLING, spread=3)
    blocks = large.reshape(size, OVERSAMPLING, size, OVERSAMPLING, 3)
    picture: Colours = blocks.mean(axis=(1, 3)).round().astype(np.uint8)
    return picture


def _draw(axes: Axes, picture: Colours) -> None:
    """Show a raster with circles around the sensor and an arrow forward, in metres."""
    from matplotlib.patches import Circle
    from matplotlib.patheffects import withStroke

    reach = REACH_M
    axes.set_axis_off()
    axes.imshow(picture, extent=(reach, -reach, -reach, reach), interpolation="nearest")
    for radius in np.arange(GRID_M, reach * 2**0.5, GRID_M):
        axes.add_patch(Circle((0, 0), radius, fill=False, ec=canvas.FAINT, lw=0.6, alpha=0.55))
        if radius < reach:
            place = radius * 0.5**0.5
            axes.text(
                *(-place, place, f"{radius:g} m"),
                color=canvas.INK,
                fontsize=8,
                path_effects=[withStroke(linewidth=2.5, foreground=canvas.NIGHT)],
            )
    axes.plot(0, 0, marker="^", color=canvas.INK, markersize=8)
    axes.set_xlim(reach, -reach)
    axes.set_ylim(-reach, reach)
