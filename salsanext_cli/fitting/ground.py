# SPDX-License-Identifier: MIT
"""The ground below a sensor, as a plane found in one scan."""

from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

from salsanext_cli.records import Float

MAX_POINTS = 512
"""Points that a plane is sought among, evenly taken from those near the sensor."""
RANGES_M = (2.0, 25.0)
"""Nearest and farthest of them: nearer is the vehicle itself, farther the ground bends."""
TRIPLES = 2048
"""Triples of points that planes are put through."""
PLANES = 256
"""Planes that are tried, of those that may be the ground."""
MIN_AREA_M2 = np.float32(1e-3)
"""Twice the least area of the triangle of a triple."""
TOLERANCE_M = 0.15
MIN_SHARE = 0.1
"""Least share of the points on a plane that is called the ground."""
MIN_POINTS = 100
MIN_HEIGHT_M = 0.4
"""Least height of a sensor; lower, the origin of the points is not the sensor's place."""
MIN_COSINE = 0.8
"""Least cosine of the angle between the ground's normal and the axis of the sensor's rotation."""
FLAT = 0.75
"""Share of the next larger one that the mean of a coordinate of directions may have, if the sensor
turns about that axis."""
AXES, UPWARDS = range(3), 2
"""Indices of x, y, z, and of z."""


@dataclass(frozen=True, slots=True)
class Ground:
    """Plane below the sensor."""

    # (3,) float64: unit normal, from the ground to the sensor; where the origin is on it, along the
    # nearest axis
    up: npt.NDArray[np.float64]
    height: float  # Distance of the origin from it, in metres; just below 0 if it is on it
    share: float  # Of the near points that lie on it, 0…1

    @property
    def tilt_deg(self) -> float:
        """Angle between its normal and the z axis, 0° if z is up, 180° upside down."""
        return float(np.degrees(np.arccos(np.clip(self.up[UPWARDS], -1, 1))))


def find_ground(points: Float, max_tilt_deg: float | None = None) -> Ground | None:
    """Return the plane that most points near the sensor lie on and few below, None without one.

    Planes through random triples of points, the same for every scan; the best is fitted to its
    points by least squares (Fischler & Bolles 1981). Points count by their range, since the rings
    near the sensor have most of them.

    `points` (N, 3) float32, in metres, around the sensor or its vehicle; some of a scan are enough;
    `max_tilt_deg`: largest angle between normal and z. Without it the orientation is any, if the
    sensor turns about an axis of the frame; one that looks one way cannot tell ground from walls,
    so that the ground leans no more than that of a sensor that turns about z.
    """
    ranges = np.sqrt(np.einsum("nk,nk->n", points, points))
    near = np.flatnonzero((ranges > RANGES_M[0]) & (ranges < RANGES_M[1]))
    if len(near) < MIN_POINTS:
        return None
    chosen = near[:: -(-len(near) // MAX_POINTS)]
    points, weights = points[chosen], ranges[chosen]
    first, second, third = points[(_triples() * len(points)).astype(np.intp)]
    across, along = (second - first).T, (third - first).T
    normals = np.stack([across[i - 2] * along[i - 1] - across[i - 1] * along[i - 2] for i in AXES])
    offsets = np.einsum("kp,pk->p", normals, first)
    lengths = np.maximum(np.sqrt(np.einsum("kp,kp->p", normals, normals)), MIN_AREA_M2)
    axis = _axis_of_rotation(points / weights[:, None])
    upright = max_tilt_deg is not None or axis is None
    least = MIN_COSINE if max_tilt_deg is None else np.cos(np.radians(max_tilt_deg))
    along_axis = np.abs(normals[UPWARDS if axis is None or upright else axis])
    tried = np.flatnonzero(along_axis > least * lengths)[:PLANES]
    normals, offsets = (normals[:, tried] / lengths[tried]).T, offsets[tried] / lengths[tried]
    # The sensor is above; where it is on the plane, the largest coordinate of the normal rises.
    low = np.abs(offsets) < MIN_HEIGHT_M
    largest = normals[np.arange(len(tried)), np.abs(normals).argmax(axis=1)]
    turn = np.where(low, np.sign(largest), -np.sign(offsets))
    normals, offsets = turn[:, None] * normals, turn * offsets
    if upright:
        rising = normals[:, UPWARDS] > 0
        normals, offsets, low = normals[rising], offsets[rising], low[rising]
    if not len(normals):
        return None
    heights = _heights(points, normals, offsets)
    on, below = (
        np.einsum("pn,n->p", part.view(np.int8), weights)
        for part in (np.abs(heights) < TOLERANCE_M, heights < -TOLERANCE_M)
    )
    score = on - below
    score[low & (below > on / 2)] = -np.inf
    best = int(score.argmax())
    on_plane = np.abs(heights[best]) < TOLERANCE_M
    share = float(weights[on_plane].sum() / weights.sum())
    if share < MIN_SHARE or not np.isfinite(score[best]):
        return None
    centre = np.average(points[on_plane], axis=0, weights=weights[on_plane]).astype(np.float64)
    normal = np.linalg.svd(points[on_plane] - centre, full_matrices=False)[2][2]
    normal *= np.sign(normal @ normals[best])
    height = -float(normal @ centre)
    return Ground(normal, height, share) if low[best] or height > MIN_HEIGHT_M else None


@cache
def _triples() -> npt.NDArray[np.float64]:
    """Return places of the points of each triple, (3, `TRIPLES`), as shares of their number."""
    return np.random.default_rng(0).random((3, TRIPLES))


def _heights(points: Float, normals: Float, offsets: Float) -> Float:
    """Return the heights of points (N, 3) above planes (P, 3) and (P,), (P, N).

    Without a matrix product: the threads of the library for these go on computing nothing for
    a while afterwards, and take the processors from the network, 35 ms for each scan.
    """
    x, y, z = np.ascontiguousarray(points.T)
    of_x, of_y, of_z = normals.T[:, :, None]
    heights: Float = of_x * x
    heights += of_y * y
    heights += of_z * z
    heights -= offsets[:, None]
    return heights


def _axis_of_rotation(directions: Float) -> int | None:
    """Return the axis, 0 to 2, that a sensor turns about, None for one that looks one way."""
    mean = np.abs(directions).mean(axis=0)
    flattest, other = np.argsort(mean)[:2]
    return int(flattest) if mean[flattest] < FLAT * mean[other] else None
