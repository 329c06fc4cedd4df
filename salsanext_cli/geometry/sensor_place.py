# SPDX-License-Identifier: MIT
"""Position and direction up of a sensor anywhere in the frame of a scan, from the points alone.

The beams of a rotating sensor leave it evenly in all directions. So the points of a scan are spread
evenly over the directions from the sensor, and crowded, or one behind the other, from elsewhere.
The search looks for the position over the ground from which the directions are most even. It needs
neither rings nor beams, which are blurred if a program corrected the scan for the motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from salsanext_cli.geometry.beam_origin import find_origin_over
from salsanext_cli.geometry.ground import UPWARDS, find_ground
from salsanext_cli.geometry.projection import few_points, in_sensor_frame, upright_rotation
from salsanext_cli.records import Double, Float, Indices, Scan
from salsanext_cli.sensors.sensor import ORIGIN, Sensor

DIGITS = 3
MANY_POINTS, POINTS, FEW_POINTS = 65_536, 16_384, 4096
"""Points that show the exact position, the beams, and the neighbourhood of the position."""
MIN_POINTS = 1000  # Fewest points that show a position
ROWS = 182  # Cells of one degree from straight down to straight up, with an offset
OFFSETS = (0.0, 0.25, 0.5, 0.75)
OWN_M = 3.0  # Nearer points may be the vehicle
FARTHEST_M = 80.0  # Farther points do not help
USUAL_HEIGHT_M = 1.85  # Assumed unless the beams show the height; too high costs less than too low
CROWD_M = 6.0  # Size of the cells whose points are counted, to begin near the sensor
CROWDS = 3  # Fullest cells from which a search begins
REACH_M, COARSE_M, MIDDLE_M, FINE_M = 24.0, 6.0, 0.5, 0.1
"""Reach and step of the first grid around a crowd, and last steps with few and all points."""
ABOVE_M = 0.5  # Least height of objects above the ground
FLIP = np.diag([1.0, -1.0, -1.0])  # Turns z from down to up

SECTORS = 64
EMPTY = 0.25  # Share of the mean points below which a sector is empty
ROUND = 0.6  # Least share of sectors with points of a sensor that turns; the others see a fan
CROWDED = 3.0  # Most points of a sector, as a multiple of the mean, around a sensor that turns
CROWDED_NEARBY = 1.65  # The same if the neighbourhood is not searched; scans had up to 2.1
CROWDED_FAN = 2.2  # The same within a fan; solid-state sensors had 1.2 to 1.7
NEARBY_M, NEARBY = 3.0, 8  # Distance and number of the positions around the origin
GAIN_NEARBY = 1.02
"""Least factor of the evenness nearby to that at the origin; correct scans had up to 1.01."""
HIDDEN = 0.38  # Largest share of hidden points of a fan; real ones had up to 0.34
HIDDEN_M, HIDDEN_SHARE = 1.0, 0.05  # A point is hidden if it is so much farther in its cell
FARTHEST_NEAR_M = 40.0  # Largest 1 % quantile of ranges; a sensor sees something nearby
MIN_FAR_M = 15.0  # Least 99 % quantile of ranges outdoors

MIN_ROUND, MAX_CROWDED = 0.75, 2.5  # Sectors around a position that was found
MAX_CROWDED_BEAMS = 4.0  # The fullest sector, if the beams prove the position
MIN_OFFSET_M, MIN_OFFSET_OF_BEAMS_M = 1.25, 0.3
"""Least distances of a sensor from the origin; the search was up to 0.9 m off on correct scans."""
MAX_LEAN_DEG = 2.0  # Largest angle between ground normal and z axis that stays as it is
MIN_SHARPNESS = 4.0  # Least sharpness of beams that prove a position, or correct it


@dataclass(frozen=True, slots=True)
class SensorPlace:
    """Position and direction up of a sensor in the frame of a file."""

    up: Double  # (3,) unit vector away from the ground
    position: Double  # (3,) metres
    shows_beams: bool  # Whether the height is that of the beams, else it is the usual one

    @property
    def is_elsewhere(self) -> bool:
        """Whether the sensor is not where it is expected, at the origin with z up."""
        if self.up[UPWARDS] < 0 or np.hypot(*self.position[:UPWARDS]) > MIN_OFFSET_M:
            return True
        return self.shows_beams and bool(np.linalg.norm(self.position) > MIN_OFFSET_OF_BEAMS_M)


def is_out_of_place(scan: Scan, *, nearby: bool = True) -> bool:
    """Return whether the points of an upright scan seem to be seen from elsewhere than the origin.

    The search around the origin is skipped without `nearby` if the directions are even enough.
    """
    points = _usable(few_points(scan, FEW_POINTS).points)
    ranges = np.sqrt(np.einsum("nk,nk->n", points, points))
    if len(points) < MIN_POINTS or np.quantile(ranges, 0.99) < MIN_FAR_M:
        return False
    if np.quantile(ranges, 0.01) > FARTHEST_NEAR_M:
        return True
    around, crowded = _sectors(points)
    if around < ROUND:
        return crowded * around > CROWDED_FAN or _hidden_share(points) > HIDDEN
    if crowded > CROWDED:
        return True
    if not nearby and crowded < CROWDED_NEARBY:
        return False
    angles = np.arange(NEARBY) * 2 * np.pi / NEARBY
    ring = NEARBY_M * np.stack([np.cos(angles), np.sin(angles), np.zeros(NEARBY)], axis=1)
    best = max(evenness(points, position) for position in ring)
    return best > GAIN_NEARBY * evenness(points, np.zeros(3))


def is_outdoors(scan: Scan) -> bool:
    """Return whether a scan has enough points, and far ones."""
    points = _usable(few_points(scan, FEW_POINTS).points)
    ranges = np.sqrt(np.einsum("nk,nk->n", points, points))
    return len(points) >= MIN_POINTS and bool(np.quantile(ranges, 0.99) >= MIN_FAR_M)


def find_place(scan: Scan, *, verified: bool = True) -> SensorPlace | None:
    """Return position and direction up of the sensor of a scan, or None if they do not show.

    The frame may have its origin anywhere within kilometres, and z up or down. Without `verified`,
    the best position is returned even if nothing proves it.
    """
    many = _usable(few_points(scan, MANY_POINTS).points)
    if len(many) < MIN_POINTS:
        return None
    points, few = (many[:: -(-len(many) // count)] for count in (POINTS, FEW_POINTS))
    views = [view for crowd in _crowds(few) if (view := _view_from(few, crowd))]
    if not views:
        return None
    best = max(views, key=lambda view: evenness(view.upright(few), view.seen_from))
    # The ground near the sensor differs from that near the crowd.
    best = _view_from(few, best.position, best) or best
    upright = best.upright(many)
    position = _climbed(upright, best.seen_from, MIDDLE_M, FINE_M, OFFSETS)
    best = replace(best, seen_from=position)
    return _verified(best, points) or (None if verified else best.place)


def placed_sensor(scan: Scan, sensor: Sensor) -> Sensor:
    """Return the sensor with the origin of a registered scan; unchanged if it does not show."""
    upright = in_sensor_frame(scan, replace(sensor, origin=ORIGIN))
    place = find_place(upright, verified=False)
    if place is None or place.up[UPWARDS] < 0:
        return sensor
    rotation = upright_rotation(np.asarray(sensor.up))
    origin = (rotation.T @ place.position).round(DIGITS) + 0.0
    return replace(sensor, origin=tuple(origin.tolist()))


@dataclass(frozen=True, slots=True)
class _View:
    """Frame with the ground at z = 0, and a position over it."""

    rotation: Double  # (3, 3) from the frame of the file
    shift: Double  # (3,): added after the rotation
    seen_from: Double  # (3,) in this frame

    def upright(self, points: Double) -> Double:
        """Return points (N, 3) of the file in this frame, those near the position."""
        turned = points @ self.rotation.T + self.shift
        aside = turned[:, :2] - self.seen_from[:2]
        return turned[np.einsum("nk,nk->n", aside, aside) < FARTHEST_M**2]

    def in_file(self, position: Double) -> Double:
        """Return a position (3,) of this frame in the frame of the file."""
        return self.rotation.T @ (position - self.shift)

    @property
    def position(self) -> Double:
        """Position of the sensor in the frame of the file."""
        return self.in_file(self.seen_from)

    @property
    def place(self) -> SensorPlace:
        """Place of the sensor, whose height is the usual one."""
        return SensorPlace(_snapped(self.rotation[UPWARDS]), self.position, shows_beams=False)


def _view_from(points: Double, start: Double, earlier: _View | None = None) -> _View | None:
    """Return the view over the ground around a start (3,), from the most even position there."""
    centred = points - start
    best: _View | None = None
    most = 0.0
    for flip in (np.eye(3), FLIP) if earlier is None else (earlier.rotation,):
        turned = centred @ flip.T
        ground = find_ground(turned.astype(np.float32))
        if ground is None or ground.up[2] < np.cos(np.pi / 4):
            continue
        rotation = upright_rotation(ground.up) @ flip
        heights = (centred @ rotation.T)[:, 2] + ground.height
        near = np.einsum("nk,nk->n", centred, centred) < REACH_M**2
        objects = float((heights[near] > ABOVE_M).mean() - (heights[near] < -ABOVE_M).mean())
        if objects > most:
            shift = np.array([0, 0, ground.height]) - rotation @ start
            most = objects
            best = _View(rotation, shift, np.array([0, 0, USUAL_HEIGHT_M]))
    if best is None:
        return None
    upright = best.upright(points)
    if earlier is None:
        steps = np.arange(-REACH_M, REACH_M + COARSE_M / 2, COARSE_M)
        grid = [best.seen_from + (x, y, 0) for x in steps for y in steps]
        best = replace(best, seen_from=max(grid, key=lambda place: evenness(upright, place)))
    return replace(best, seen_from=_climbed(upright, best.seen_from, COARSE_M / 2, MIDDLE_M))


def _climbed(
    points: Double, position: Double, step: float, last: float, offsets: Sequence[float] = (0.0,)
) -> Double:
    """Return the most even position (3,) at the same height, by ever shorter steps in metres."""
    while step > last:
        sides = (-step, 0, step)
        grid = [position + (x, y, 0) for x in sides for y in sides]
        position = max(grid, key=lambda place: evenness(points, place, offsets))
        step /= 2
    return position


def _verified(view: _View, points: Double) -> SensorPlace | None:
    """Return the place of a view; by its beams if they show it, None if nothing proves it."""
    place = view.place
    around, crowded = _sectors(view.upright(points) - view.seen_from)
    if around < ROUND or crowded > MAX_CROWDED_BEAMS:
        return None
    if (position := _origin_of_beams(view, place, points)) is not None:
        axis = np.array([0.0, 0.0, np.sign(place.up[UPWARDS])])
        return SensorPlace(axis, position, shows_beams=True)
    return place if around >= MIN_ROUND and crowded <= MAX_CROWDED else None


def _snapped(up: Double) -> Double:
    """Return the z axis, up or down, for a direction (3,) near it: roads and sensors lean a bit."""
    is_near = abs(up[UPWARDS]) > np.cos(np.radians(MAX_LEAN_DEG))
    return np.array([0.0, 0.0, np.sign(up[UPWARDS])]) if is_near else up


def _origin_of_beams(view: _View, place: SensorPlace, points: Double) -> Double | None:
    """Return the position (3,) in the file from which the beams of objects are clearly sharp.

    The axis of the sensor must be the z axis of the file, up or down.
    """
    heights = (points @ view.rotation.T + view.shift)[:, 2]
    # A comb is sharp about the axis of the sensor, not about the normal of the ground.
    axes = np.eye(3) if place.up[UPWARDS] > 0 else FLIP
    objects = points[heights > ABOVE_M] @ axes.T
    on_ground = place.position - place.up * USUAL_HEIGHT_M
    starts = [on_ground]
    if np.hypot(*(axes @ place.position)[:2]) < NEARBY_M:
        starts.append(
            place.up * (place.up @ on_ground)
        )  # The sensor may be right above the origin.
    origins = [find_origin_over(objects, axes @ start) for start in starts]
    best = max(origins, key=lambda origin: origin.sharpness)
    return axes.T @ best.position if best.sharpness > MIN_SHARPNESS else None


def evenness(points: Double, position: Double, offsets: Sequence[float] = (0.0,)) -> float:
    """Return how evenly points (N, 3) are spread over the directions from a position (3,), 0…1.

    It is the share of farther points, divided by their mean number in the cell of a point. The mean
    over cells that begin at several offsets, 0…1, has less noise.
    """
    around, upwards, ranges = _directions(points - position)
    far = ranges > OWN_M
    around, upwards = around[far], upwards[far]
    shares = []
    for offset in offsets:
        counts = np.bincount(_cells(around + offset, upwards + offset)).astype(np.float64)
        shares.append(len(around) ** 2 / max(float(counts @ counts), 1.0) / max(len(points), 1))
    return float(np.mean(shares))


def _directions(points: Double) -> tuple[Double, Double, Double]:
    """Return azimuth and elevation, in degrees from 0, and range of each point (N, 3)."""
    x, y, z = points.T
    flat = np.hypot(x, y)
    around = np.arctan2(y, x) * (180 / np.pi) + 180
    return around, np.arctan2(z, flat) * (180 / np.pi) + 90, np.hypot(flat, z)


def _cells(around: Double, upwards: Double) -> Indices:
    """Return the cell of each direction (N,) in degrees from 0."""
    return around.astype(np.intp) * ROWS + upwards.astype(np.intp)


def _hidden_share(points: Double) -> float:
    """Return the share of points (N, 3) far behind the nearest one of their direction, 0…1."""
    around, upwards, ranges = _directions(points)
    cells = _cells(around, upwards)
    nearest = np.full(cells.max() + 1, np.inf)
    np.minimum.at(nearest, cells, ranges)
    limit = HIDDEN_M + (1 + HIDDEN_SHARE) * nearest[cells]
    return float((ranges > limit).mean())


def _sectors(points: Double) -> tuple[float, float]:
    """Return the share of sectors with points, and the fullest as a multiple of the mean."""
    far = points[np.einsum("nk,nk->n", points, points) > OWN_M**2]
    around = (np.arctan2(far[:, 1], far[:, 0]) / (2 * np.pi) + 0.5) * SECTORS
    counts = np.bincount(around.astype(np.intp) % SECTORS, minlength=SECTORS)
    mean = max(len(far), 1) / SECTORS
    return float((counts > EMPTY * mean).mean()), float(counts.max() / mean)


def _crowds(points: Double) -> list[Double]:
    """Return the means (3,) of the points of the fullest cells of space, the fullest first."""
    keys = np.floor(points / CROWD_M).astype(np.int64)
    _, cell_of_point, counts = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    fullest = np.argsort(-counts, kind="stable")[:CROWDS]
    return [points[cell_of_point.ravel() == cell].mean(axis=0) for cell in fullest]


def _usable(points: Float) -> Double:
    """Return the measured points (M, 3), float64."""
    return points[np.isfinite(points).all(axis=1) & points.any(axis=1)].astype(np.float64)
