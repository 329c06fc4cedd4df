# SPDX-License-Identifier: MIT
"""Names beside dots, placed so that they do not cover each other."""

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
"""Pixels from a dot to its name, in the order in which they are tried."""
DIRECTIONS_DEG = (0, 180, 90, 270, 30, 330, 150, 210, 60, 300, 120, 240)
"""Degrees around a dot, in the order in which they are tried."""
DOT_PX = 6
"""Half the width of what a name must not cover, in pixels."""


def name_dots(axes: Axes, x: Ratios, y: Ratios, names: Sequence[str], colour: str) -> None:
    """Write a name beside each dot; where there is no room, farther away with a line to it.

    Parameters
    ----------
    axes : Axes
        Its limits and scales are set already.
    x, y : (N,) float64
        Where the dots are, in data.
    names : sequence of str
        What to write; a dollar sign is not taken for mathematics.
    colour : str
        Colour of the text.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.lines import Line2D
    from matplotlib.transforms import Bbox, IdentityTransform

    dots = axes.transData.transform(np.stack([x, y], axis=1))
    taken = [Bbox([dot - DOT_PX, dot + DOT_PX]) for dot in dots]
    pixels = IdentityTransform()
    style: dict[str, Any] = {"size": 9, "color": colour, "va": "center", "parse_math": False}
    renderer = FigureCanvasAgg(axes.get_figure(root=True)).get_renderer()  # type: ignore[no-untyped-call]
    for dot, name in zip(dots, names, strict=True):
        text = axes.text(0, 0, name, transform=pixels, **style)
        size = np.array(text.get_window_extent(renderer).size)
        box = _free_place(dot, size, taken, axes.bbox)
        text.set_position((box.x0, (box.y0 + box.y1) / 2))
        taken.append(box)
        nearest = np.clip(dot, box.min, box.max)
        if np.linalg.norm(nearest - dot) > DISTANCES_PX[1]:
            ends = np.stack([dot, nearest], axis=1)
            axes.add_line(Line2D(*ends, transform=pixels, color=FAINT, linewidth=0.7))


def _free_place(dot: Ratios, size: Ratios, taken: Sequence[Bbox], inside: Bbox) -> Bbox:
    """Return the nearest box of a size that covers none and lies inside; all in pixels."""
    from matplotlib.transforms import Bbox

    boxes = []
    for distance in DISTANCES_PX:
        for direction in np.radians(DIRECTIONS_DEG).tolist():
            across, up = distance * math.cos(direction), distance * math.sin(direction)
            side = round(math.cos(direction))
            left, bottom = dot + (across - size[0] * (1 - side) / 2, up - size[1] / 2)
            box = Bbox.from_bounds(left, bottom, *size)
            within = all(inside.contains(*corner) for corner in (box.min, box.max))
            if within and not box.count_overlaps(taken):
                return box
            boxes.append(box)
    return boxes[0]
