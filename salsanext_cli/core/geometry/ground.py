# SPDX-License-Identifier: MIT
"""Ground in a scan: the plane below the sensor."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from salsanext_cli.core.geometry.point_sample import few_points
from salsanext_cli.core.records import Double, Float, Mask, Scan

MAX_POINTS = 512  # Points near the sensor to find a plane among
RANGES_M = (2.0, 25.0)  # Their ranges: nearer is the vehicle, farther the ground bends
TRIPLES = 2048  # Triples of points that define planes
PLANES = 256  # Planes that are compared, among possible grounds
MIN_AREA_M2 = np.float32(1e-3)  # Twice the least area of the triangle of a triple
TOLERANCE_M = 0.15
MIN_SHARE = 0.1  # Least share of the points on the ground
MIN_GROUND_POINTS = 100
MIN_HEIGHT_M = 0.4  # Least height of a sensor; a lower origin is not at the sensor
MIN_COSINE = 0.8  # Least cosine of the angle between ground normal and rotation axis
FLAT = 0.75  # Largest ratio of the two least mean coordinates if the sensor turns about an axis
MAX_TILT_DEG = 8.0
"""Largest angle between ground normal and z of an upright sensor; real ones had up to 5°."""
UPSIDE_DOWN_DEG = 155.0  # Least angle of a ground above the sensor
SUPPORT = 1.5  # Least factor between the points of a tilted ground and of the best level one
SUPPORT_OF_CEILING = 4.0
"""The same for a ground above the sensor; ceilings of simulated rooms had up to 3.7."""
OBJECT_M = 0.5  # Least distance of objects from the ground
HEIGHTS_M = (1.0, 2.6)  # Usual heights of a sensor on a vehicle; real scans had 1.4 to 2.1
AXES = range(3)  # Indices of x, y, z
UPWARDS = 2  # Index of z


@dataclass(frozen=True, slots=True, kw_only=True)
class Ground:
    """Plane below the sensor."""

    # (3,) float64: unit normal from the ground to the sensor; along the nearest axis if the origin
    # is on the ground
    up: Double
    height: float  # Height of the origin in metres; 0 on the ground, negative below it
    share: float  # Share of the near points on the ground, 0…1

    @property
    def tilt_deg(self) -> float:
        """Angle between the normal and the z axis, 0° if z is up, 180° upside down."""
        return float(np.degrees(np.arccos(np.clip(self.up[UPWARDS], -1, 1))))

    @property
    def is_usual(self) -> bool:
        """Whether the height is usual for a sensor on a vehicle."""
        return HEIGHTS_M[0] <= self.height <= HEIGHTS_M[1]


@dataclass(frozen=True, slots=True, eq=False)
class _NearPoints:
    """Sample of the points near the sensor."""

    points: Float  # (K, 3) metres
    ranges: Float  # (K,) metres


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Planes:
    """Possible grounds: points x with ``normals @ x = offsets``."""

    normals: Float  # (P, 3): unit normals from the ground to the sensor
    offsets: Float  # (P,) metres
    is_low: Mask  # (P,): whether the sensor is on the plane

    def select(self, selection: Mask) -> _Planes:
        """Return the planes of a mask (P,)."""
        return _Planes(
            normals=self.normals[selection],
            offsets=self.offsets[selection],
            is_low=self.is_low[selection],
        )


def find_ground(points: Float, max_tilt_deg: float | None = None) -> Ground | None:
    """Return the plane with most of the points near the sensor and few below.

    Planes through random triples, the same for every scan, are compared. The best is fitted to its
    points by least squares (Fischler & Bolles 1981). A point counts by its range, since the rings
    near the sensor have most points. Without a limit of the tilt, the ground of a sensor that turns
    about an axis has any orientation. A sensor with a narrow field of view cannot tell ground from
    walls, so its ground must be nearly level.

    Parameters
    ----------
    points : (N, 3) float32
        Finite coordinates in metres, around the sensor.
    max_tilt_deg : float, optional
        Largest angle between normal and z in degrees.

    Returns
    -------
    Ground or None
        None if there are few points near the sensor, or no plane has enough of them.
    """
    near = _near_points(points)
    if near is None:
        return None
    planes = _possible_planes(near, max_tilt_deg)
    if not len(planes.normals):
        return None
    heights = _heights_above(planes, near.points)
    ranges_on_plane = _sums(np.abs(heights) < TOLERANCE_M, near.ranges)
    ranges_below = _sums(heights < -TOLERANCE_M, near.ranges)
    score = ranges_on_plane - ranges_below
    score[planes.is_low & (ranges_below > ranges_on_plane / 2)] = -np.inf
    best = int(score.argmax())
    on_plane = np.abs(heights[best]) < TOLERANCE_M
    share = float(near.ranges[on_plane].sum() / near.ranges.sum())
    if share < MIN_SHARE or not np.isfinite(score[best]):
        return None
    return _fitted_ground(near, on_plane, planes, best, share)


def _near_points(points: Float) -> _NearPoints | None:
    """Return a sample of the points (N, 3) within `RANGES_M`, None for too few."""
    ranges = np.sqrt(np.einsum("nk,nk->n", points, points))
    near = np.flatnonzero((ranges > RANGES_M[0]) & (ranges < RANGES_M[1]))
    if len(near) < MIN_GROUND_POINTS:
        return None
    step = -(-len(near) // MAX_POINTS)
    sample = near[::step]
    return _NearPoints(points[sample], ranges[sample])


def _possible_planes(near: _NearPoints, max_tilt_deg: float | None) -> _Planes:
    """Return the first planes through random triples of points that may be the ground."""
    points = near.points
    first, second, third = points[(_triples() * len(points)).astype(np.intp)]
    normals = _cross_products((second - first).T, (third - first).T)
    offsets = np.einsum("kp,pk->p", normals, first)
    lengths = np.maximum(np.sqrt(np.einsum("kp,kp->p", normals, normals)), MIN_AREA_M2)
    axis = _axis_of_rotation(points / near.ranges[:, None])
    is_upright = max_tilt_deg is not None or axis is None
    least = MIN_COSINE if max_tilt_deg is None else np.cos(np.radians(max_tilt_deg))
    along_axis = np.abs(normals[UPWARDS if axis is None or is_upright else axis])
    tried = np.flatnonzero(along_axis > least * lengths)[:PLANES]
    normals = (normals[:, tried] / lengths[tried]).T
    offsets = offsets[tried] / lengths[tried]
    # The sensor is above. If it is on the plane, the largest coordinate of the normal is positive.
    is_low = np.abs(offsets) < MIN_HEIGHT_M
    largest = normals[np.arange(len(tried)), np.abs(normals).argmax(axis=1)]
    turn = np.where(is_low, np.sign(largest), -np.sign(offsets))
    planes = _Planes(normals=turn[:, None] * normals, offsets=turn * offsets, is_low=is_low)
    return planes.select(planes.normals[:, UPWARDS] > 0) if is_upright else planes


def _cross_products(first: Float, second: Float) -> Float:
    """Return the cross products (3, P) of vectors (3, P)."""
    # np.cross takes twice as long.
    rows = [first[i - 2] * second[i - 1] - first[i - 1] * second[i - 2] for i in AXES]
    return np.stack(rows)


def _heights_above(planes: _Planes, points: Float) -> Float:
    """Return the heights (P, K) of points (K, 3) above each plane, in metres."""
    # The threads of a matrix product would take the processors from the network.
    x, y, z = np.ascontiguousarray(points.T)
    normal_x, normal_y, normal_z = planes.normals.T[:, :, None]
    products = normal_x * x + normal_y * y + normal_z * z
    return products - planes.offsets[:, None]


def _sums(selection: Mask, ranges: Float) -> Float:
    """Return the sums (P,) of the ranges (K,) of the selected points of each plane (P, K)."""
    return np.einsum("pn,n->p", selection.view(np.int8), ranges)


def _fitted_ground(
    near: _NearPoints, on_plane: Mask, planes: _Planes, best: int, share: float
) -> Ground | None:
    """Return the ground through the points on a plane; None if it is not below the sensor."""
    points = near.points[on_plane]
    centre = np.average(points, axis=0, weights=near.ranges[on_plane]).astype(np.float64)
    normal = np.linalg.svd(points - centre, full_matrices=False)[2][2]
    normal *= np.sign(normal @ planes.normals[best])
    height = -float(normal @ centre)
    is_below = bool(planes.is_low[best]) or height > MIN_HEIGHT_M
    return Ground(up=normal, height=height, share=share) if is_below else None


@cache
def _triples() -> Double:
    """Return the indices of the points of each triple, (3, `TRIPLES`), as shares of the number."""
    return np.random.default_rng(0).random((3, TRIPLES))


def _axis_of_rotation(directions: Float) -> int | None:
    """Return the axis, 0 to 2, that a sensor turns about; None for a narrow field of view."""
    mean = np.abs(directions).mean(axis=0)
    flattest, other = np.argsort(mean)[:2]
    return int(flattest) if mean[flattest] < FLAT * mean[other] else None


def ground_of(scan: Scan) -> Ground | None:
    """Return the ground in a scan, if any; a tilted one must be likelier than a level one."""
    points = finite_points(few_points(scan))
    ground = find_ground(points)
    if ground is None or ground.tilt_deg <= MAX_TILT_DEG:
        return ground
    level = find_ground(points, MAX_TILT_DEG)
    if ground.tilt_deg > UPSIDE_DOWN_DEG and _is_seen_from_below(points, ground):
        return Ground(up=-ground.up, height=-ground.height, share=ground.share)
    is_possible = ground.is_usual or ground.height < MIN_HEIGHT_M
    in_room = level and level.height > TOLERANCE_M and ground.tilt_deg > UPSIDE_DOWN_DEG
    support = SUPPORT_OF_CEILING if in_room else SUPPORT
    is_likely = level is None or ground.share > support * level.share
    return ground if is_possible and is_likely else level


def _is_seen_from_below(points: Float, ground: Ground) -> bool:
    """Return whether most objects among points (N, 3) lie behind the ground.

    Then the origin of the frame is below the ground, where no sensor is.
    """
    near = np.einsum("nk,nk->n", points, points) < RANGES_M[1] ** 2
    x, y, z = points[near].T
    heights = ground.up[0] * x + ground.up[1] * y + ground.up[2] * z + ground.height
    behind = (heights < -OBJECT_M).sum()
    return bool(behind > (heights > OBJECT_M).sum())


def finite_points(scan: Scan) -> Float:
    """Return the points (M, 3) of a scan whose coordinates are finite."""
    return scan.points[np.isfinite(scan.points).all(axis=1)]
