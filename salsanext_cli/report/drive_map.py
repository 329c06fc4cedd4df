# SPDX-License-Identifier: MIT
"""Top view of a drive: the labelled points of its scans, and the trajectory of the sensor."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from salsanext_cli.core.records import Double, Float
from salsanext_cli.report import canvas
from salsanext_cli.report.canvas import MARGIN_PX
from salsanext_cli.report.colours import Colours, Legend
from salsanext_cli.report.scan_pictures import raster

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SIZE_PX = 1000  # Side of the square map
HEAD_PX = 56
SHARE_INSIDE = 0.98  # Share of the points within the map
SPREAD_PX = 2


def drive_map_picture(
    heading: str, points: Double, colours: Colours, trajectory: Double, legend: Legend
) -> bytes:
    """Draw the top view of a drive as a PNG: x is up, y is left, and the start is a triangle.

    Parameters
    ----------
    heading : str
        First line.
    points : (N, 3) float64
        Points in the frame of the drive, metres; they may be far from its origin.
    colours : (N, 3) uint8
        Their colours.
    trajectory : (S, 3) float64
        Positions of the sensor in the order of the drive, metres.
    legend : sequence of (str, colour)
        Names of the colours.

    Returns
    -------
    bytes
        Content of a PNG file.
    """
    middle = (trajectory.min(axis=0) + trajectory.max(axis=0)) / 2
    relative = (points - middle).astype(np.float32)
    reach = _reach(relative, trajectory - middle)
    height = HEAD_PX + SIZE_PX + MARGIN_PX
    figure = canvas.new_picture(SIZE_PX + 2 * MARGIN_PX, height, legend, SIZE_PX)
    canvas.text_at(figure, MARGIN_PX, HEAD_PX // 2, heading, 18)
    axes = canvas.axes_at(figure, MARGIN_PX, HEAD_PX, SIZE_PX, SIZE_PX)
    axes.set_axis_off()
    picture = raster(relative, colours, reach, SIZE_PX, SPREAD_PX)
    axes.imshow(picture, extent=(reach, -reach, -reach, reach), interpolation="nearest")
    _draw_trajectory(axes, trajectory - middle)
    _draw_scale(axes, reach)
    axes.set_xlim(reach, -reach)
    axes.set_ylim(-reach, reach)
    return canvas.png_of(figure)


def _reach(points: Float, trajectory: Double) -> float:
    """Return the distance from the middle to an edge, metres: the whole trajectory, most points."""
    farthest = float(np.abs(trajectory[:, :2]).max()) + 10
    if len(points):
        distances = np.abs(points[:, :2]).max(axis=1)
        farthest = max(farthest, float(np.quantile(distances, SHARE_INSIDE)))
    return farthest


def _draw_trajectory(axes: Axes, trajectory: Double) -> None:
    """Draw the trajectory of the sensor, and a triangle at its start."""
    style = _outlined()
    axes.plot(trajectory[:, 1], trajectory[:, 0], linewidth=1.6, **style)
    axes.plot(trajectory[0, 1], trajectory[0, 0], marker="^", markersize=9, **style)


def _draw_scale(axes: Axes, reach: float) -> None:
    """Draw a line of a round length, with that length, in the lower left corner."""
    length = round_length(reach / 2)
    left = 0.94 * reach
    low = -0.94 * reach
    style = _outlined()
    axes.plot((left, left - length), (low, low), linewidth=3, **style)
    axes.text(left, low + 0.012 * reach, f"{length:g} m", fontsize=11, va="bottom", **style)


def _outlined() -> dict[str, Any]:
    """Return the style of light lines and texts that are legible on any colour."""
    from matplotlib.patheffects import withStroke

    outline = withStroke(linewidth=4, foreground=canvas.NIGHT)
    return {"color": canvas.INK, "path_effects": [outline]}


def round_length(longest: float) -> float:
    """Return the largest of 1, 2 or 5 times a power of ten that is not above a length."""
    power = 10.0 ** math.floor(math.log10(longest))
    return max(step * power for step in (1, 2, 5) if step * power <= longest)
