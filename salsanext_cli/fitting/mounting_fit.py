# SPDX-License-Identifier: MIT
"""Direction up and origin of a sensor in the frame of its files, from a few of its scans."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from salsanext_cli.geometry.projection import few_points, in_sensor_frame, upright_rotation
from salsanext_cli.records import Double, Float, Scan
from salsanext_cli.sensors.sensor import FITTED_NAME, ORIGIN, UP, Sensor

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
AXES, UPWARDS = range(3), 2  # Indices of x, y, z, and of z


@dataclass(frozen=True, slots=True)
class Ground:
    """Plane below the sensor."""

    # (3,) float64: unit normal from the ground to the sensor; along the nearest axis if the origin
    # is on the ground
    up: Double
    height: float  # Height of the origin in metres; around 0 if it is on the ground
    share: float  # Share of the near points on the ground, 0…1

    @property
    def tilt_deg(self) -> float:
        """Angle between the normal and the z axis, 0° if z is up, 180° upside down."""
        return float(np.degrees(np.arccos(np.clip(self.up[UPWARDS], -1, 1))))

    @property
    def is_usual(self) -> bool:
        """Whether the height is usual for a sensor on a vehicle."""
        return HEIGHTS_M[0] <= self.height <= HEIGHTS_M[1]


def find_ground(points: Float, max_tilt_deg: float | None = None) -> Ground | None:
    """Return the plane with most of the points (N, 3) near the sensor and few below, or None.

    Planes through random triples, the same for every scan, are compared. The best is fitted to its
    points by least squares (Fischler & Bolles 1981). A point counts by its range, since the rings
    near the sensor have most points. `max_tilt_deg` limits the angle between normal and z. Without
    it, the ground of a sensor that turns about an axis has any orientation. A sensor with a narrow
    field of view cannot tell ground from walls, so its ground must be nearly level.
    """
    ranges = np.sqrt(np.einsum("nk,nk->n", points, points))
    near = np.flatnonzero((ranges > RANGES_M[0]) & (ranges < RANGES_M[1]))
    if len(near) < MIN_GROUND_POINTS:
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
    # The sensor is above. If it is on the plane, the largest coordinate of the normal is positive.
    low = np.abs(offsets) < MIN_HEIGHT_M
    largest = normals[np.arange(len(tried)), np.abs(normals).argmax(axis=1)]
    turn = np.where(low, np.sign(largest), -np.sign(offsets))
    normals, offsets = turn[:, None] * normals, turn * offsets
    if upright:
        rising = normals[:, UPWARDS] > 0
        normals, offsets, low = normals[rising], offsets[rising], low[rising]
    if not len(normals):
        return None
    # The threads of a matrix product would take the processors from the network.
    (x, y, z), (of_x, of_y, of_z) = np.ascontiguousarray(points.T), normals.T[:, :, None]
    heights = of_x * x + of_y * y + of_z * z - offsets[:, None]
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
def _triples() -> Double:
    """Return the indices of the points of each triple, (3, `TRIPLES`), as shares of the number."""
    return np.random.default_rng(0).random((3, TRIPLES))


def _axis_of_rotation(directions: Float) -> int | None:
    """Return the axis, 0 to 2, that a sensor turns about; None for a narrow field of view."""
    mean = np.abs(directions).mean(axis=0)
    flattest, other = np.argsort(mean)[:2]
    return int(flattest) if mean[flattest] < FLAT * mean[other] else None


BIN_DEG = 0.02
FINE_BINS, COARSE_BINS = 3, 51  # Widths of histogram averages: within a tooth, over several
DISTANCES_M = (2.0, 60.0)  # Distances of points that show the origin of the beams
FAR_M = 15.0  # Least distance of points that show its height at any position in the plane
AHEAD_M, ASIDE_M, ABOVE_M = (-3.0, 3.0), (-1.5, 1.5), (-1.0, 5.0)
"""Bounds of the sensor ahead of the origin of the files, to its left and above it."""
STEP_OF_HEIGHT_M, STEP_M, LAST_STEP_M = 0.05, 0.25, 0.01
MIN_SHARPNESS = 1.4
"""Least sharpness of a comb: sensors of 32 to 128 beams had 1.8 to 20; a Livox had 1.1."""
MIN_SHARPNESS_ELSEWHERE, MIN_GAIN = 1.6, 1.5
"""Least sharpness elsewhere than at the origin, and least factor to that at the origin.

Accumulated clouds had up to 1.4 and 1.1; sensors had at least 2.4 and 2."""
MIN_POINTS_OF_ORIGIN = 1000


def find_origin(points: Float) -> tuple[float, float, float] | None:
    """Return the origin of the beams by upright points (N, 3) without the ground, or None."""
    doubles: Double = points.astype(np.float64)
    distances = np.hypot(doubles[:, 0], doubles[:, 1])
    near, far = (
        doubles[(distances > least) & (distances < DISTANCES_M[1])]
        for least in (DISTANCES_M[0], FAR_M)
    )
    at_origin = sharpness(near, np.zeros(3)) if len(near) >= MIN_POINTS_OF_ORIGIN else 0.0
    if at_origin > MIN_SHARPNESS:
        return 0.0, 0.0, 0.0
    if len(far) < MIN_POINTS_OF_ORIGIN:
        return None
    position = _sharpest(far, _grid((0,), (0,), np.arange(*ABOVE_M, STEP_OF_HEIGHT_M)))
    ahead, aside = (np.arange(low, high + STEP_M / 2, STEP_M) for low, high in (AHEAD_M, ASIDE_M))
    position = _sharpest(near, position + _grid(ahead, aside, (0,)))
    step = STEP_M / 2
    while step > LAST_STEP_M:
        position = _sharpest(near, position + step * _grid(*[(-1, 0, 1)] * 3))
        step /= 2
    sharp = sharpness(near, position) > max(MIN_SHARPNESS_ELSEWHERE, MIN_GAIN * at_origin)
    x, y, z = position.tolist()
    inside = AHEAD_M[0] < x < AHEAD_M[1] and ASIDE_M[0] < y < ASIDE_M[1]
    return (x, y, z) if inside and sharp else None


def _grid(*axes: Sequence[float] | Double) -> Double:
    """Return all points with coordinates on three axes, (N, 3) float64."""
    mesh = np.meshgrid(*axes)
    return np.stack(mesh, axis=-1, dtype=np.float64).reshape(-1, 3)


def _sharpest(points: Double, positions: Double) -> Double:
    return max(positions, key=lambda position: sharpness(points, position))


def sharpness(points: Double, position: Double) -> float:
    """Return how clearly elevations from a position form a comb of beams; about 1 without one."""
    x, y, z = (points - position).T
    elevations = np.degrees(np.arctan2(z, np.hypot(x, y)))
    bins = ((elevations + 90) / BIN_DEG).astype(np.intp)
    histogram = np.bincount(bins, minlength=round(180 / BIN_DEG) + 1).astype(np.float64)
    fine, coarse = (_averaged(histogram, width) for width in (FINE_BINS, COARSE_BINS))
    return float(fine @ fine / (fine @ coarse))


def _averaged(histogram: Double, width: int) -> Double:
    sums: Double = np.cumsum(np.pad(histogram, (width // 2 + 1, width // 2)))
    return (sums[width:] - sums[:-width]) / width


MAX_TILT_DEG = 8.0
"""Largest angle between ground normal and z of an upright sensor; real ones had up to 5°."""
UPSIDE_DOWN_DEG = 155.0  # Least angle of a ground above the sensor
SUPPORT = 1.5  # Least factor between the points of a tilted ground and of the best level one
SUPPORT_OF_CEILING = 4.0
"""The same for a ground above the sensor; ceilings of simulated rooms had up to 3.7."""
HEIGHTS_M = (1.0, 2.6)  # Usual heights of a sensor on a vehicle; real scans had 1.4 to 2.1
USUAL_HEIGHT_M = 1.75  # Assumed if the origin is on the ground and the beams do not show it
MIN_THICKNESS_M = 1.0  # Least height of the points above the ground of a sensor of several beams
MIN_OFFSET_M = 0.3  # Least distance from the origin that counts; optical centres are 0.2 m off
SCANS_OF_ORIGIN, POINTS_OF_ORIGIN = 4, 8192  # Scans that show the origin, and points of each
DIGITS = 3


def fit_mounting(scans: Sequence[Scan], sensor: Sensor) -> Sensor:
    """Return the sensor with the direction up and the origin fitted to scans.

    The direction up changes if the ground of most scans is tilted by more than `MAX_TILT_DEG`. The
    origin changes if most scans show no ground at a height of `HEIGHTS_M`, as in the frame of a
    vehicle. It becomes the origin of the beams, if the scans show it. Else it becomes the usual
    height if the ground passes through the origin.
    """
    sensor = replace(sensor, up=UP, origin=ORIGIN)
    grounds = [ground for scan in scans if (ground := ground_of(scan))]
    tilted = [ground.up for ground in grounds if ground.tilt_deg > MAX_TILT_DEG]
    if len(tilted) > len(scans) / 2:
        up = np.median(tilted, axis=0)
        direction = (up / np.linalg.norm(up)).round(DIGITS)
        sensor = replace(sensor, name=FITTED_NAME, up=tuple(direction.tolist()))
    heights = [ground.height for ground in grounds]
    if not scans or sum(ground.is_usual for ground in grounds) >= len(scans) / 2:
        return sensor
    position = _origin_of_beams(scans, sensor, float(np.median(heights)) if heights else None)
    if position is None or np.linalg.norm(position) < MIN_OFFSET_M:
        return sensor
    in_files = upright_rotation(np.asarray(sensor.up)).T @ position
    return replace(sensor, name=FITTED_NAME, origin=tuple(in_files.round(DIGITS).tolist()))


def _origin_of_beams(
    scans: Sequence[Scan], sensor: Sensor, height: float | None
) -> tuple[float, float, float] | None:
    """Return the position of the sensor in upright scans whose origin is at a height, if known."""
    upright = [in_sensor_frame(scan, sensor) for scan in scans[:SCANS_OF_ORIGIN]]
    # Without the ground, which has most points near the sensor.
    above = -np.inf if height is None else MIN_HEIGHT_M - height
    rest = [scan.take(np.flatnonzero(scan.points[:, 2] > above)) for scan in upright]
    points = np.concatenate([_finite(few_points(scan, POINTS_OF_ORIGIN)) for scan in rest])
    if (position := find_origin(points)) is not None:
        return position
    flat = np.ptp(points[:, 2]) < MIN_THICKNESS_M if len(points) else True
    if flat or height is None or abs(height) > MIN_HEIGHT_M:
        return None
    return 0.0, 0.0, USUAL_HEIGHT_M - height


def ground_of(scan: Scan) -> Ground | None:
    """Return the ground in a scan, if any; a tilted one must be likelier than a level one."""
    points = _finite(few_points(scan))
    ground = find_ground(points)
    if ground is None or ground.tilt_deg <= MAX_TILT_DEG:
        return ground
    level = find_ground(points, MAX_TILT_DEG)
    usual = ground.is_usual or ground.height < MIN_HEIGHT_M
    in_room = level and level.height > TOLERANCE_M and ground.tilt_deg > UPSIDE_DOWN_DEG
    support = SUPPORT_OF_CEILING if in_room else SUPPORT
    likely = level is None or ground.share > support * level.share
    return ground if usual and likely else level


def _finite(scan: Scan) -> Float:
    return scan.points[np.isfinite(scan.points).all(axis=1)]
