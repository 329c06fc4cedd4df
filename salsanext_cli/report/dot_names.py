# SPDX-License-Identifier: MIT
"""Names beside dots, without overlaps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from salsanext_cli.measures.confusion import Ratios
from salsanext_cli.report.canvas import FAINT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.transforms import Bbox

DISTANCES_PX = (9, 16, 26, 40, 56, 76, 100)
"""Distances from a dot to its name in pixels, in the order of the attempts."""
DIRECTIONS_DEG = (0, 180, 90, 270, 30, 330, 150, 210, 60, 300, 120, 240)
"""Directions from a dot to its name in degrees, in the order of the attempts."""
DOT_PX = 6
"""Half the width in pixels of the square around a dot that no name may cover."""


def name_dots(axes: Axes, x: Ratios, y: Ratios, names: Sequence[str], colour: str) -> None:
    """Write a name beside each dot, or farther away with a line to it if the place is occupied.

    Parameters
    ----------
    axes : Axes
        Axes with their final limits and scales.
    x, y : (N,) float64
        Data coordinates of the dots.
    names : sequence of str
        Texts; a dollar sign does not start mathematics.
    colour : str
        Colour of the text.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.lines import Line2D
    from matplotlib.transforms import Bbox, IdentityTransform

    dots = axes.transData.transform(np.stack([x, y], axis=1))
    occupied = [Bbox([dot - DOT_PX, dot + DOT_PX]) for dot in dots]
    pixels = IdentityTransform()
    style: dict[str, Any] = {"size": 9, "color": colour, "va": "center", "parse_math": False}
    renderer = FigureCanvasAgg(axes.get_figure(root=True)).get_renderer()  # type: ignore[no-untyped-call]
    for dot, name in zip(dots, names, strict=True):
        text = axes.text(0, 0, name, transform=pixels, **style)
        size = np.array(text.get_window_extent(renderer).size)
        box = _free_place(dot, size, occupied, axes.bbox)
        text.set_position((box.x0, (box.y0 + box.y1) / 2))
        occupied.append(box)
        nearest = np.clip(dot, box.min, box.max)
        if np.linalg.norm(nearest - dot) > DISTANCES_PX[1]:
            ends = np.stack([dot, nearest], axis=1)
            axes.add_line(Line2D(*ends, transform=pixels, color=FAINT, linewidth=0.7))


def _free_place(dot: Ratios, size: Ratios, occupied: Sequence[Bbox], inside: Bbox) -> Bbox:
    """Return the nearest box of a size that overlaps none and lies inside; all in pixels."""
    from matplotlib.transforms import Bbox

    boxes = []
    for distance in DISTANCES_PX:
        for direction in np.radians(DIRECTIONS_DEG).tolist():
            across, up = distance * math.cos(direction), distance * math.sin(direction)
            side = round(math.cos(direction))
            left, bottom = dot + (across - size[0] * (1 - side) / 2, up - size[1] / 2)
            box = Bbox.from_bounds(left, bottom, *size)
            within = all(inside.contains(*corner) for corner in (box.min, box.max))
            if within and not box.count_overlaps(occupied):
                return box
            boxes.append(box)
    return boxes[0]
