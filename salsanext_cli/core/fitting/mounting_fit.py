# SPDX-License-Identifier: MIT
"""Direction up and origin of a sensor in the frame of its files, from a few of its scans."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from salsanext_cli.core.geometry.beam_origin import (
    PROVING_SHARPNESS,
    find_origin,
    sharpness_at_origin,
)
from salsanext_cli.core.geometry.evenness import is_fan, is_out_of_place
from salsanext_cli.core.geometry.ground import (
    MAX_TILT_DEG,
    MIN_HEIGHT_M,
    UPWARDS,
    Ground,
    finite_points,
    ground_of,
)
from salsanext_cli.core.geometry.projection import few_points, in_sensor_frame, upright_rotation
from salsanext_cli.core.geometry.sensor_place import (
    MIN_OFFSET_OF_BEAMS_M,
    ORIGIN_DIGITS,
    USUAL_HEIGHT_M,
    SensorPlace,
    find_place,
    origin_in_file,
)
from salsanext_cli.core.records import Double, Float, Scan
from salsanext_cli.core.sensors.sensor import FITTED_NAME, ORIGIN, UP, Sensor

MIN_THICKNESS_M = 1.0  # Least height of the points above the ground of a sensor of several beams
SCANS_OF_ORIGIN = 4  # Scans that show the origin
POINTS_OF_ORIGIN = 8192  # Points of each of these
SHARPER = 1.1
"""Least factor between the sharpness of another position and of a sharp origin; scans of 32 beams
that were moved by 4 or 5 m had 1.18 or more."""
SHARPER_M = 0.5  # Least distance between them; correct scans had up to 0.35 m
MIN_OUT_OF_PLACE = 1 / 3  # Least share of scans that are seen from elsewhere
MIN_FOUND = 0.5  # Least share of these whose sensor is found
REGISTERED_M = 2.0  # Least distance of a position from the median in scans of a moving sensor


def fit_mounting(scans: Sequence[Scan], sensor: Sensor) -> Sensor:
    """Return the sensor with the direction up and the origin fitted to scans.

    The direction up changes if the ground of most scans is tilted by more than `MAX_TILT_DEG`. The
    origin changes if the points are seen from elsewhere, or if most scans show no ground at a usual
    height, as in the frame of a vehicle. It becomes the origin of the beams, if the scans show it;
    else the position from which the directions of the points are even; else the usual height if the
    origin is on the ground or below it. If the positions differ, as in scans that were registered
    to a map, each scan has its own origin.
    """
    sensor = replace(sensor, up=UP, origin=ORIGIN, registered=False)
    grounds = [ground for scan in scans if (ground := ground_of(scan))]
    sensor = _turned(sensor, grounds, len(scans))
    upright = [in_sensor_frame(scan, sensor) for scan in scans]
    if not scans or sum(ground.is_usual for ground in grounds) >= len(scans) / 2:
        return _placed(_UprightScans(upright), sensor)
    heights = [ground.height for ground in grounds]
    height = float(np.median(heights)) if heights else None
    placed = _placed(_UprightScans(upright, height, all_doubtful=True), sensor)
    if placed != sensor:
        return placed
    position = _position_of_beams(_objects(upright, height), height)
    if position is None or np.linalg.norm(position) < MIN_OFFSET_OF_BEAMS_M:
        return sensor
    return _with_origin(sensor, position)


def _turned(sensor: Sensor, grounds: Sequence[Ground], count: int) -> Sensor:
    """Return the sensor turned upright if the grounds of most of `count` scans are tilted."""
    tilted = [ground.up for ground in grounds if ground.tilt_deg > MAX_TILT_DEG]
    return _with_up(sensor, np.median(tilted, axis=0)) if len(tilted) > count / 2 else sensor


def _with_up(sensor: Sensor, up: Double) -> Sensor:
    """Return the sensor with the direction up (3,), of any length, in the frame of the files."""
    direction = (up / np.linalg.norm(up)).round(ORIGIN_DIGITS) + 0.0
    return replace(sensor, name=FITTED_NAME, up=tuple(direction.tolist()))


def _with_origin(sensor: Sensor, position: Double) -> Sensor:
    """Return the sensor at a position (3,) in its upright frame."""
    return replace(sensor, name=FITTED_NAME, origin=origin_in_file(position, sensor))


def _objects(upright: Sequence[Scan], height: float | None) -> Float:
    """Return points (N, 3) of upright scans without the ground, `height` below if it is known.

    The ground has most points near the sensor.
    """
    above = -np.inf if height is None else MIN_HEIGHT_M - height
    objects = [
        scan.take(np.flatnonzero(scan.points[:, UPWARDS] > above))
        for scan in upright[:SCANS_OF_ORIGIN]
    ]
    return np.concatenate([finite_points(few_points(scan, POINTS_OF_ORIGIN)) for scan in objects])


def _position_of_beams(points: Float, height: float | None) -> Double | None:
    """Return the position (3,) of the sensor by upright objects around an origin at a height."""
    if (origin := find_origin(points)) is not None:
        return np.array(origin)
    flat = np.ptp(points[:, UPWARDS]) < MIN_THICKNESS_M if len(points) else True
    if flat or height is None or height > MIN_HEIGHT_M:
        return None
    return np.array([0.0, 0.0, USUAL_HEIGHT_M - height])


@dataclass(frozen=True, slots=True)
class _UprightScans:
    """Upright scans, and the places of their sensor, each of which is searched once."""

    scans: Sequence[Scan]
    height: float | None = None  # Height of the origin above the ground in metres, if it is unusual
    all_doubtful: bool = False  # Whether no scan shows that its origin is at the sensor
    _uneven: dict[int, bool] = field(default_factory=dict, init=False)
    _places: dict[int, SensorPlace | None] = field(default_factory=dict, init=False)

    def is_doubtful(self, number: int) -> bool:
        """Return whether a scan may be seen from elsewhere than the origin."""
        return self.all_doubtful or self.is_uneven(number)

    def is_uneven(self, number: int) -> bool:
        """Return whether the points of a scan do not look as if seen from the origin."""
        if number not in self._uneven:
            self._uneven[number] = is_out_of_place(self.scans[number])
        return self._uneven[number]

    def place(self, number: int) -> SensorPlace | None:
        """Return the place of the sensor in a scan, None if it is unknown."""
        if number not in self._places:
            self._places[number] = find_place(self.scans[number])
        return self._places[number]

    def place_elsewhere(self, number: int) -> SensorPlace | None:
        """Return the place in a scan, None if it is unknown or the origin."""
        place = self.place(number)
        if place is None or not place.is_elsewhere:
            return None
        if is_fan(self.scans[number], even=True) and not place.shows_beams:
            return None  # Positions within a fan see points all around.
        if self.is_uneven(number):
            return place
        return place if self._is_sharper(number, place) else None

    def _is_sharper(self, number: int, place: SensorPlace) -> bool:
        """Return whether beams do not rather start from the origin than from another place."""
        objects = _objects([self.scans[number]], self.height)
        at_origin = sharpness_at_origin(objects)
        if at_origin <= PROVING_SHARPNESS:
            return True
        there = sharpness_at_origin(objects - place.position.astype(np.float32))
        is_apart = bool(np.linalg.norm(place.position) > SHARPER_M)
        return is_apart and there > SHARPER * at_origin


def _placed(upright: _UprightScans, sensor: Sensor) -> Sensor:
    """Return the sensor placed where upright scans are seen from, if that is not the origin."""
    numbers = range(len(upright.scans))
    sample = numbers[:: -(-len(numbers) // SCANS_OF_ORIGIN) or 1]
    if not any(upright.is_doubtful(number) for number in sample):
        return sensor
    if not any(upright.place_elsewhere(number) for number in sample):
        return sensor
    doubtful = [number for number in numbers if upright.is_doubtful(number)]
    elsewhere = [place for number in doubtful if (place := upright.place_elsewhere(number))]
    if len(elsewhere) < max(MIN_FOUND * len(doubtful), MIN_OUT_OF_PLACE * len(numbers), 1):
        return sensor
    others = [place for n in numbers if n not in doubtful and (place := upright.place(n))]
    positions = np.array([place.position for place in (*elsewhere, *others)])
    proven = [place.position for place in elsewhere if place.shows_beams]
    centre = np.median(proven or [place.position for place in elsewhere], axis=0)
    distances = np.hypot(*(positions - centre)[:, :UPWARDS].T)
    is_registered = bool(distances.max() > REGISTERED_M)
    up = _common_up(elsewhere)
    if is_registered:  # Its frame is level or upside down.
        up = np.array([0, 0, np.sign(up[UPWARDS])])
    upwards = sensor
    if up[UPWARDS] < 1:
        upwards = _with_up(sensor, upright_rotation(np.asarray(sensor.up)).T @ up)
    if is_registered:
        return replace(upwards, name=FITTED_NAME, registered=True)
    origin = origin_in_file(centre, sensor)
    return replace(upwards, name=FITTED_NAME, origin=origin)


def _common_up(places: Sequence[SensorPlace]) -> Double:
    """Return the median direction up (3,) on the side of the ground that most places show."""
    # The median of two opposite directions would be none.
    side = 1 if sum(float(np.sign(place.up[UPWARDS])) for place in places) >= 0 else -1
    directions = [place.up for place in places if np.sign(place.up[UPWARDS]) == side]
    up: Double = np.median(directions, axis=0)
    return up
