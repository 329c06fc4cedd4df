# SPDX-License-Identifier: MIT
"""Render points in perspective, from a camera behind and above the sensor."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from matplotlib import colormaps
from PIL import Image, ImageDraw, ImageFont

BACKGROUND = (24, 26, 32)
INK = (235, 235, 235)
CAMERA = np.array([-16.0, 0.0, 11.0])
TARGET = np.array([9.0, 0.0, -1.0])
FOCAL = 0.85
"""Focal length as a share of the width of the picture."""
REACH_M = 55.0
SUPERSAMPLING = 2
ERROR_MARKS = (0.0, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
"""Errors at equal steps of the colour map."""

Colours = npt.NDArray[np.uint8]


def error_colours(error: npt.NDArray[np.floating]) -> Colours:
    """Colour probabilities of error, (N,) to (N, 3) uint8."""
    share = np.interp(np.nan_to_num(error), ERROR_MARKS, np.linspace(0.25, 1, len(ERROR_MARKS)))
    return (colormaps["inferno"](share)[:, :3] * 255).astype(np.uint8)


def rendered(
    points: npt.NDArray[np.floating], colours: Colours, width: int, height: int
) -> Image.Image:
    """Render points (N, 3) in metres, sensor frame, with their colours (N, 3)."""
    wide, high = width * SUPERSAMPLING, height * SUPERSAMPLING
    forward = (TARGET - CAMERA) / np.linalg.norm(TARGET - CAMERA)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    relative = points - CAMERA
    depth = relative @ forward
    near = (depth > 1) & (np.linalg.norm(points[:, :2], axis=1) < REACH_M)
    depth, relative, colours = depth[near], relative[near], colours[near]
    scale = FOCAL * wide / depth
    column = wide / 2 + scale * (relative @ right)
    row = high / 2 - scale * (relative @ np.cross(right, forward))
    canvas = np.full((high, wide, 3), BACKGROUND, np.uint8)
    # Far points are drawn first; near ones are larger and cover them.
    order = np.argsort(-depth)
    size = np.clip(np.rint(45 * SUPERSAMPLING / depth), 1, 3 * SUPERSAMPLING).astype(int)[order]
    column, row, colours = column[order].astype(int), row[order].astype(int), colours[order]
    for down in range(size.max()):
        for across in range(size.max()):
            x, y = column + across, row + down
            drawn = (size > max(down, across)) & (x >= 0) & (x < wide) & (y >= 0) & (y < high)
            canvas[y[drawn], x[drawn]] = colours[drawn]
    return Image.fromarray(canvas).resize((width, height), Image.Resampling.BOX)


def in_a_row(
    panels: Sequence[tuple[str, Image.Image]], gap: int = 6, head: int = 34
) -> Image.Image:
    """Put titled pictures of one size side by side."""
    width, height = panels[0][1].size
    sheet = Image.new("RGB", (len(panels) * (width + gap) - gap, height + head), BACKGROUND)
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(22)
    for number, (title, panel) in enumerate(panels):
        left = number * (width + gap)
        sheet.paste(panel, (left, head))
        draw.text((left + 6, 3), title, INK, font)
    return sheet
