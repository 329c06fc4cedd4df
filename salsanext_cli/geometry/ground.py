# SPDX-License-Identifier: MIT
"""The ground below a sensor, as a plane found in one scan."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from salsanext_cli.records import Float

MAX_POINTS = 512
"""Points that a plane is sought among, evenly taken from those near the sensor."""
RANGES_M = (2.0, 25.0)
"""Nearest and farthest of them: nearer is the vehicle itself, farther the ground bends."""
PLANES = 512
"""Planes that are tried, each through three points; of 128, one in ten was not the ground where no
more than a quarter of the points lie on it."""
TOLERANCE_M = 0.15
MIN_SHARE = 0.1
"""Least share of the points on a plane that is called the ground."""
MIN_POINTS = 100
MIN_HEIGHT_M = 0.3
"""Least height of a sensor; lower, the plane is some part of what carries it."""
MAX_LEAN = 0.8
"""Least cosine of the angle between the ground's normal and the axis of the sensor's rotation."""
FLAT = 0.75
"""Share of the next larger one that the mean of a coordinate of directions may have, if the sensor
turns about that axis."""


@dataclass(frozen=True, slots=True)
class Ground:
    """Plane below the sensor.

    Attributes
    ----------
    up : (3,) float64
        Unit normal, from the ground to the sensor.
    height : float
        Distance of the sensor from it, in metres.
    share : float
        Of the near points that lie on it, 0…1.
    """

    up: npt.NDArray[np.float64]
    height: float
    share: float

    @property
    def tilt_deg(self) -> float:
        """Angle between its normal and the z axis, 0° if z is up, 180° upside down."""
        return float(np.degrees(np.arccos(np.clip(self.up[2], -1, 1))))


def find_ground(points: Float) -> Ground | None:
    """Return the plane that most points near the sensor lie on and few below, None without one.

    Planes through random triples of points, the same for every scan; the best is fitted to its
    points by least squares (Fischler & Bolles 1981). Points count by their range, since the rings
    near the sensor have most of them.

    Parameters
    ----------
    points : (N, 3) float32
        In metres, with the sensor at the origin, in any orientation; some of a scan are enough.
    """
    ranges = np.sqrt(np.einsum("nk,nk->n", points, points))
    near = np.flatnonzero((ranges > RANGES_M[0]) & (ranges < RANGES_M[1]))
    if len(near) < MIN_POINTS:
        return None
    chosen = near[:: -(-len(near) // MAX_POINTS)]
    points, weights = points[chosen], ranges[chosen]
    triples = np.random.default_rng(0).integers(0, len(points), (3, PLANES))
    first, second, third = points[triples]
    normals = np.cross(second - first, third - first)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.float32(1e-6))
    axis = _axis_of_rotation(points / weights[:, None])
    if axis is not None:
        likely = np.abs(normals[:, axis]) >= MAX_LEAN
        normals, first = normals[likely], first[likely]
        if not len(normals):
            return None
    offsets = np.einsum("pk,pk->p", normals, first)
    # The sensor is above.
    normals *= -np.sign(offsets)[:, None]
    heights = _heights(points, normals, np.abs(offsets))
    counted = (np.abs(heights) < TOLERANCE_M).view(np.int8)
    counted -= (heights < -TOLERANCE_M).view(np.int8)
    score = np.einsum("pn,n->p", counted, weights)
    best = int(score.argmax())
    on_plane = np.abs(heights[best]) < TOLERANCE_M
    share = float(weights[on_plane].sum() / weights.sum())
    if share < MIN_SHARE:
        return None
    centre = np.average(points[on_plane], axis=0, weights=weights[on_plane]).astype(np.float64)
    normal = np.linalg.svd(points[on_plane] - centre, full_matrices=False)[2][2]
    offset = float(normal @ centre)
    if abs(offset) < MIN_HEIGHT_M:
        return None
    return Ground(-np.sign(offset) * normal, abs(offset), share)


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
    heights += offsets[:, None]
    return heights


def _axis_of_rotation(directions: Float) -> int | None:
    """Return the axis, 0 to 2, that a sensor turns about, None for one that looks one way."""
    mean = np.abs(directions).mean(axis=0)
    flattest, other = np.argsort(mean)[:2]
    return int(flattest) if mean[flattest] < FLAT * mean[other] else None
