# SPDX-License-Identifier: MIT
"""Points of a street between two walls, seen from above its ground."""

import numpy as np


def street_points(azimuth, elevation, height, farthest, noise):
    """Return the points (N, 3) that rays in some directions (radians) hit.

    `farthest` bounds their ranges, in metres, and `noise` (N,) is added to these. The nearer of the
    walls has most of them.
    """
    rays = np.stack(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ],
        axis=1,
    )
    with np.errstate(divide="ignore"):
        ground = np.where(rays[:, 2] < 0, -height / rays[:, 2], np.inf)
        wall = np.where(rays[:, 1] > 0, 6, -9) / rays[:, 1]
    ranges = np.minimum(np.minimum(ground, wall), farthest) + noise
    return (rays * ranges[:, None]).astype(np.float32)
