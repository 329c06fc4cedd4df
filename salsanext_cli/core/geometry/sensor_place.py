# SPDX-License-Identifier: MIT
"""Search for the position of a sensor anywhere in the frame of a scan, from the points alone.

The search looks for the position over the ground from which the directions are most even. It needs
neither rings nor beams, which are blurred if a program corrected the scan for the motion.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from salsanext_cli.core.geometry.beam_origin import PROVING_SHARPNESS, find_origin_over
from salsanext_cli.core.geometry.evenness import (
    FEW_POINTS,
    MIN_POINTS,
    NEARBY_M,
    evenness,
    measured_positions,
    sectors_around,
)
from salsanext_cli.core.geometry.ground import UPWARDS, find_ground
from salsanext_cli.core.geometry.point_sample import few_points
from salsanext_cli.core.geometry.sensor_frame import in_sensor_frame, upright_rotation
from salsanext_cli.core.memo import Memo
from salsanext_cli.core.records import Double, Scan
from salsanext_cli.core.sensors.sensor import ORIGIN, Sensor

ORIGIN_DIGITS = 3  # Digits of an origin in metres
MANY_POINTS = 65_536  # Points that show the exact position
POINTS = 16_384  # Points that show the beams; `FEW_POINTS` show the neighbourhood of the position
OFFSETS = (0.0, 0.25, 0.5, 0.75)  # Offsets of the cells of the exact position
FARTHEST_M = 80.0  # Farther points do not help
USUAL_HEIGHT_M = 1.85  # Assumed unless the beams show the height; too high costs less than too low
CROWD_M = 6.0  # Size of the cells whose points are counted, to begin near the sensor
CROWDS = 3  # Fullest cells from which a search begins
REACH_M = 24.0  # Reach of the first grid around a crowd
COARSE_M = 6.0  # Step of this grid
MIDDLE_M = 0.5  # Last step with few points
FINE_M = 0.1  # Last step with many points
ABOVE_M = 0.5  # Least height of objects above the ground
FLIP = np.diag([1.0, -1.0, -1.0])  # Turns z from down to up

MIN_ROUND = 0.75  # Least share of occupied sectors around a position that no beams prove
MAX_CROWDED = 2.5  # The fullest sector there, as a multiple of the mean
MAX_CROWDED_BEAMS = 4.0  # The fullest sector, if the beams prove the position
MIN_OFFSET_M = 1.25  # Least distance of a sensor from the origin; the search was up to 0.9 m off
MIN_OFFSET_OF_BEAMS_M = 0.3  # The same if the beams show it; optical centres are 0.2 m off
MAX_LEAN_DEG = 2.0  # Largest angle between ground normal and z axis that stays as it is
REMEMBERED = 256
"""Places that are remembered; a run asks again for those of scans that it reads at once."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorPlace:
    """Position and direction up of a sensor in the frame of a file."""

    up: Double  # (3,) unit vector away from the ground
    position: Double  # (3,) metres
    shows_beams: bool  # Whether the height is that of the beams, else it is the usual one

    @property
    def distance_aside(self) -> float:
        """Level distance from the origin in metres."""
        return float(np.hypot(self.position[0], self.position[1]))

    @property
    def is_elsewhere(self) -> bool:
        """Whether the sensor is not where it is expected, at the origin with z up."""
        if self.up[UPWARDS] < 0 or self.distance_aside > MIN_OFFSET_M:
            return True
        return self.shows_beams and bool(np.linalg.norm(self.position) > MIN_OFFSET_OF_BEAMS_M)


@dataclass(frozen=True, slots=True, kw_only=True)
class _SearchedPlaces:
    """Places of the sensor of a scan."""

    proven: SensorPlace | None  # None if the points do not prove the position
    likeliest: SensorPlace | None  # None if no points could show one


_places: Memo[_SearchedPlaces] = Memo(REMEMBERED)


def find_place(scan: Scan, *, verified: bool = True) -> SensorPlace | None:
    """Return position and direction up of the sensor of a scan.

    The frame may have its origin anywhere within kilometres, and z up or down. The steps of a run
    ask for the place of the same scan, so that the last places are remembered.

    Parameters
    ----------
    scan : Scan
        Scan in the frame of its file.
    verified : bool
        Whether the points must prove the position; else the best one is returned.

    Returns
    -------
    SensorPlace or None
        None if the points do not show it.
    """
    many = measured_positions(few_points(scan, MANY_POINTS))
    if len(many) < MIN_POINTS:
        return None
    digest = hashlib.blake2b(many.tobytes(), digest_size=16).digest()
    places = _places.result(digest, partial(_searched_places, many))
    return places.proven or (None if verified else places.likeliest)


def _searched_places(many: Double) -> _SearchedPlaces:
    """Search measured points (N, 3) for the place of their sensor."""
    few = _thinned(many, FEW_POINTS)
    candidates = [_view_from(few, crowd) for crowd in _crowds(few)]
    views = [view for view in candidates if view]
    if not views:
        return _SearchedPlaces(proven=None, likeliest=None)
    best = max(views, key=lambda view: evenness(view.upright(few), view.seen_from))
    # The ground near the sensor differs from that near the crowd.
    best = _view_from(few, best.position, best) or best
    position = _climbed(best.upright(many), best.seen_from, MIDDLE_M, FINE_M, OFFSETS)
    best = replace(best, seen_from=position)
    return _SearchedPlaces(proven=_verified(best, _thinned(many, POINTS)), likeliest=best.place)


def _thinned(points: Double, count: int) -> Double:
    """Return every n-th of points (N, 3), at most `count`."""
    step = -(-len(points) // count)
    return points[::step]


def placed_sensor(scan: Scan, sensor: Sensor) -> Sensor:
    """Return the sensor with the origin of a registered scan; unchanged if it does not show."""
    fixed = replace(sensor, origin=ORIGIN)
    place = find_place(in_sensor_frame(scan, fixed), verified=False)
    if place is None or place.up[UPWARDS] < 0:
        return sensor
    return replace(sensor, origin=origin_in_file(place.position, fixed))


def origin_in_file(
    position: Double, sensor: Sensor, digits: int = ORIGIN_DIGITS
) -> tuple[float, ...]:
    """Return a position in the frame of a sensor as an `origin` in that of its files.

    Parameters
    ----------
    position : (3,) float64
        Position in metres.
    sensor : Sensor
        Sensor whose mounting leads from the files to the frame.
    digits : int
        Digits behind the decimal point.

    Returns
    -------
    tuple of float
        Three coordinates in metres.
    """
    rotation = upright_rotation(np.asarray(sensor.up))
    origin = np.asarray(sensor.origin) + rotation.T @ position
    rounded: list[float] = (origin.round(digits) + 0.0).tolist()
    return tuple(rounded)


@dataclass(frozen=True, slots=True, kw_only=True)
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

    @property
    def position(self) -> Double:
        """Position of the sensor in the frame of the file."""
        return self.rotation.T @ (self.seen_from - self.shift)

    @property
    def place(self) -> SensorPlace:
        """Place of the sensor, whose height is the usual one."""
        return SensorPlace(
            up=_snapped(self.rotation[UPWARDS]), position=self.position, shows_beams=False
        )


def _view_from(points: Double, start: Double, earlier: _View | None = None) -> _View | None:
    """Return the view over the ground around a start (3,), from the most even position there."""
    sides = (np.eye(3), FLIP) if earlier is None else (earlier.rotation,)
    view = _view_over_ground(points - start, start, sides)
    if view is None:
        return None
    upright = view.upright(points)
    if earlier is None:
        steps = np.arange(-REACH_M, REACH_M + COARSE_M / 2, COARSE_M)
        grid = [view.seen_from + (x, y, 0) for x in steps for y in steps]
        view = replace(view, seen_from=max(grid, key=lambda place: evenness(upright, place)))
    return replace(view, seen_from=_climbed(upright, view.seen_from, COARSE_M / 2, MIDDLE_M))


def _view_over_ground(centred: Double, start: Double, sides: Sequence[Double]) -> _View | None:
    """Return the view from above the start, on the side of the ground with most objects.

    `centred`: points (N, 3) from the start; `sides`: rotations (3, 3) that may turn it upright.
    """
    view: _View | None = None
    most = 0.0
    near = np.einsum("nk,nk->n", centred, centred) < REACH_M**2
    for side in sides:
        ground = find_ground((centred @ side.T).astype(np.float32))
        if ground is None or ground.up[UPWARDS] < np.cos(np.pi / 4):
            continue
        rotation = upright_rotation(ground.up) @ side
        heights = (centred[near] @ rotation.T)[:, UPWARDS] + ground.height
        objects = float((heights > ABOVE_M).mean() - (heights < -ABOVE_M).mean())
        if objects > most:
            most = objects
            shift = np.array([0, 0, ground.height]) - rotation @ start
            view = _View(rotation=rotation, shift=shift, seen_from=np.array([0, 0, USUAL_HEIGHT_M]))
    return view


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
    sectors = sectors_around(view.upright(points) - view.seen_from)
    if sectors.is_fan or sectors.fullest > MAX_CROWDED_BEAMS:
        return None
    position = _origin_of_beams(view, place, points)
    if position is not None:
        axis = np.array([0.0, 0.0, np.sign(place.up[UPWARDS])])
        return SensorPlace(up=axis, position=position, shows_beams=True)
    is_even = sectors.occupied >= MIN_ROUND and sectors.fullest <= MAX_CROWDED
    return place if is_even else None


def _snapped(up: Double) -> Double:
    """Return the z axis, up or down, for a direction (3,) near it; roads and sensors are tilted."""
    is_near = abs(up[UPWARDS]) > np.cos(np.radians(MAX_LEAN_DEG))
    return np.array([0.0, 0.0, np.sign(up[UPWARDS])]) if is_near else up


def _origin_of_beams(view: _View, place: SensorPlace, points: Double) -> Double | None:
    """Return the position (3,) in the file from which the beams of objects are clearly sharp.

    The axis of the sensor must be the z axis of the file, up or down.
    """
    heights = (points @ view.rotation.T + view.shift)[:, UPWARDS]
    # A comb is sharp about the axis of the sensor, not about the normal of the ground.
    axes = np.eye(3) if place.up[UPWARDS] > 0 else FLIP
    objects = points[heights > ABOVE_M] @ axes.T
    on_ground = place.position - place.up * USUAL_HEIGHT_M
    starts = [on_ground]
    if place.distance_aside < NEARBY_M:
        # The sensor may be right above the origin.
        starts.append(place.up * (place.up @ on_ground))
    origins = [find_origin_over(objects, axes @ start) for start in starts]
    best = max(origins, key=lambda origin: origin.sharpness)
    return axes.T @ best.position if best.sharpness > PROVING_SHARPNESS else None


def _crowds(points: Double) -> list[Double]:
    """Return the means (3,) of the points of the fullest cells of space, the fullest first."""
    keys = np.floor(points / CROWD_M).astype(np.int64)
    _, cell_of_point, counts = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    fullest = np.argsort(-counts, kind="stable")[:CROWDS]
    return [points[cell_of_point.ravel() == cell].mean(axis=0) for cell in fullest]
