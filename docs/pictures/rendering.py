# SPDX-License-Identifier: MIT
"""Render points in perspective, from a camera that circles around the sensor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from PIL import Image

BACKGROUND = (24, 26, 32)
FOCAL = 0.95
"""Focal length as a share of the width of the picture."""
REACH_M = 55.0
NEAREST_M = 1.0
SUPERSAMPLING = 2
POINT_SIZE_M = 0.1
"""Width of the square that a point fills, unless it is smaller than a pixel."""
LARGEST_POINT_PX = 4

Colours = npt.NDArray[np.uint8]
Points = npt.NDArray[np.floating]


@dataclass(frozen=True)
class Camera:
    """Place of a camera, and the point that it looks at, in metres in the frame of the sensor."""

    place: tuple[float, float, float] = (-16.0, 0.0, 13.0)
    target: tuple[float, float, float] = (7.0, 0.0, -1.0)

    def turned(self, degrees: float) -> Camera:
        """Return the camera turned around the vertical axis of the sensor, to the left."""
        angle = np.radians(degrees)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])

        def moved(point: tuple[float, float, float]) -> tuple[float, float, float]:
            """Return a point turned around the axis."""
            x, y = (turn @ point[:2]).tolist()
            return x, y, point[2]

        return Camera(moved(self.place), moved(self.target))

    def seen(self, points: Points) -> Points:
        """Return points (N, 3) as right, up and depth of the camera, (N, 3) in metres."""
        forward = np.subtract(self.target, self.place)
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0, 0, 1.0])
        right /= np.linalg.norm(right)
        axes = np.stack([right, np.cross(right, forward), forward])
        return (points - self.place) @ axes.T


def rendered(
    points: Points, colours: Colours, width: int, height: int, camera: Camera
) -> Image.Image:
    """Render points near the sensor.

    Parameters
    ----------
    points : (N, 3) float
        Points in metres, in the frame of the sensor.
    colours : (N, 3) uint8
        Their red, green and blue.
    width, height : int
        Size of the picture in pixels.
    camera : Camera
        From where they are seen.
    """
    wide = width * SUPERSAMPLING
    high = height * SUPERSAMPLING
    seen = camera.seen(points)
    near = (seen[:, 2] > NEAREST_M) & (np.linalg.norm(points[:, :2], axis=1) < REACH_M)
    # Far points are drawn first; near ones are larger and cover them.
    order = np.flatnonzero(near)
    order = order[np.argsort(-seen[order, 2])]
    right, up, depth = seen[order].T
    colours = colours[order]
    scale = FOCAL * wide / depth
    column = (wide / 2 + scale * right).astype(int)
    row = (high / 2 - scale * up).astype(int)
    size = np.rint(scale * POINT_SIZE_M)
    size = np.clip(size, SUPERSAMPLING, LARGEST_POINT_PX * SUPERSAMPLING).astype(int)
    canvas = np.full((high, wide, 3), BACKGROUND, np.uint8)
    largest = size.max(initial=0)
    for down in range(largest):
        for across in range(largest):
            x = column + across
            y = row + down
            drawn = (size > max(down, across)) & (x >= 0) & (x < wide) & (y >= 0) & (y < high)
            canvas[y[drawn], x[drawn]] = colours[drawn]
    return Image.fromarray(canvas).resize((width, height), Image.Resampling.BOX)
