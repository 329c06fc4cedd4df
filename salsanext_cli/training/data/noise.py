# SPDX-License-Identifier: MIT
"""Shortcomings of real sensors: holes in range images, noise of positions.

The frequencies of holes are those of real scans in 64 x 512 pixels, the mean over Pandar64 (second
drive of PandaSet), VLP-32C (front sectors of RWTH Aachen), OS0-128, OS1-128 and OS2-32 (captures of
Ouster): `benchmarks/hole_shares.py` learns them. Intensity is left out: dark surfaces have more
holes in some of these sensors and fewer in others.
"""

import numpy as np
import numpy.typing as npt

from salsanext_cli.records import Float

Rng = np.random.Generator

MAX_RUN = 4
"""Most pixels between two measured ones of a row of which the holes among them are counted."""
EDGE_RATIO = 1.1
"""Ratio of the ranges on both sides above which there is an edge between them."""
RANGE_EDGES_M = (5.0, 10.0, 20.0, 40.0)
"""Bounds of the bins of the range on the nearer side."""
HOLE_SHARES = np.array(
    [
        [0.064, 0.026, 0.026, 0.051, 0.067],
        [0.119, 0.114, 0.115, 0.149, 0.176],
    ]
)
"""Share of holes on surfaces and at edges, by range."""
CONTINUED = 0.42
"""Share of holes whose neighbour to the right is a hole, too."""
MOST_HOLES = 2.0
"""Largest factor of the shares: that of the sensor with the most holes, OS2-32."""
MOST_JITTER_M = 0.03
"""Largest standard deviation of positions: of ranges it is what makers state as typical."""


def hole_cells(ranges: Float) -> npt.NDArray[np.intp]:
    """Return the cell of `HOLE_SHARES`, counted row by row, of each pixel of ranges (H, W).

    It depends on the next measured pixels (those above 0) to the left and to the right around the
    circle, whether or not the pixel itself is measured; -1 where the two are more than `MAX_RUN`
    pixels apart.
    """
    sides, steps = np.zeros((2, *ranges.shape), np.float32), np.full((2, *ranges.shape), MAX_RUN)
    for step in range(MAX_RUN, 0, -1):
        for side, signed in enumerate((step, -step)):
            neighbour = np.roll(ranges, signed, axis=1)
            np.copyto(sides[side], neighbour, where=neighbour > 0)
            np.copyto(steps[side], step, where=neighbour > 0)
    near, far = sides.min(axis=0), sides.max(axis=0)
    cells = np.digitize(near, RANGE_EDGES_M) + (far > EDGE_RATIO * near) * HOLE_SHARES.shape[1]
    between = (near > 0) & (steps.sum(axis=0) - 1 <= MAX_RUN)
    return np.where(between, cells, -1)


def make_holes(channels: Float, random: Rng) -> Float:
    """Return channels (C, H, W), the range first, of which pixels are lost as real sensors do.

    Each is lost with the share of its cell times a factor that is uniform up to `MOST_HOLES`. With
    probability `CONTINUED` a pixel shares the random number of its left neighbour, so that holes
    come in runs.
    """
    shares = np.append(HOLE_SHARES, 0.0)[hole_cells(channels[0])] * random.uniform(0, MOST_HOLES)
    chance, own = random.random(shares.shape), random.random(shares.shape) >= CONTINUED
    source = np.maximum.accumulate(np.where(own, np.arange(own.shape[1]), 0), axis=1)
    lost = np.take_along_axis(chance, source, axis=1) < shares
    return np.where(lost, np.float32(0), channels)


def jitter(points: Float, random: Rng) -> Float:
    """Return points (N, 3) with normal noise of one standard deviation, drawn, on x, y and z.

    Those at the origin measure nothing and stay.
    """
    deviation = np.float32(random.uniform(0, MOST_JITTER_M))
    noise = deviation * random.standard_normal(points.shape, np.float32)
    moved: Float = points + noise * (points != 0).any(axis=1, keepdims=True)
    return moved
