# SPDX-License-Identifier: MIT
"""Direction up and origin of a sensor in the frame of its files, from a few of its scans."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from salsanext_cli.core.fitting.upright_scans import (
    SCANS_OF_ORIGIN,
    UprightScans,
    points_above_ground,
)
from salsanext_cli.core.geometry.beam_origin import find_origin
from salsanext_cli.core.geometry.ground import (
    MAX_TILT_DEG,
    MIN_HEIGHT_M,
    UPWARDS,
    Ground,
    ground_of,
)
from salsanext_cli.core.geometry.sensor_frame import in_sensor_frame, upright_rotation
from salsanext_cli.core.geometry.sensor_place import (
    MIN_OFFSET_OF_BEAMS_M,
    ORIGIN_DIGITS,
    USUAL_HEIGHT_M,
    SensorPlace,
    origin_in_file,
)
from salsanext_cli.core.records import Double, Float, Scan
from salsanext_cli.core.sensors.sensor import FITTED_NAME, ORIGIN, UP, Sensor

MIN_THICKNESS_M = 1.0  # Least height of the points above the ground of a sensor of several beams
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

    Parameters
    ----------
    scans : sequence of Scan
        A few scans of the sensor, in the frame of their files.
    sensor : Sensor
        Sensor whose mounting is replaced.

    Returns
    -------
    Sensor
    """
    sensor = replace(sensor, up=UP, origin=ORIGIN, registered=False)
    grounds = [ground for ground in map(ground_of, scans) if ground]
    sensor = _turned(sensor, grounds, len(scans))
    upright = [in_sensor_frame(scan, sensor) for scan in scans]
    if not scans or sum(ground.is_usual for ground in grounds) >= len(scans) / 2:
        return _placed(UprightScans(upright), sensor)
    heights = [ground.height for ground in grounds]
    height = float(np.median(heights)) if heights else None
    placed = _placed(UprightScans(upright, height, all_doubtful=True), sensor)
    if placed != sensor:
        return placed
    position = _position_of_beams(points_above_ground(upright, height), height)
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


def _position_of_beams(points: Float, height: float | None) -> Double | None:
    """Return the position (3,) of the sensor by upright objects around an origin at a height."""
    origin = find_origin(points)
    if origin is not None:
        return np.array(origin)
    is_flat = not len(points) or np.ptp(points[:, UPWARDS]) < MIN_THICKNESS_M
    if is_flat or height is None or height > MIN_HEIGHT_M:
        return None
    return np.array([0.0, 0.0, USUAL_HEIGHT_M - height])


def _placed(upright: UprightScans, sensor: Sensor) -> Sensor:
    """Return the sensor placed where upright scans are seen from, if that is not the origin."""
    places = _places_elsewhere(upright)
    if places is None:
        return sensor
    proven = [place.position for place in places.elsewhere if place.shows_beams]
    centre = np.median(proven or [place.position for place in places.elsewhere], axis=0)
    positions = np.array([place.position for place in places.elsewhere + places.others])
    aside = (positions - centre)[:, :UPWARDS]
    is_registered = bool(np.hypot(aside[:, 0], aside[:, 1]).max() > REGISTERED_M)
    up = _common_up(places.elsewhere)
    if is_registered:  # Its frame is level or upside down.
        up = np.array([0, 0, np.sign(up[UPWARDS])])
    upwards = sensor
    if up[UPWARDS] < 1:
        upwards = _with_up(sensor, upright_rotation(np.asarray(sensor.up)).T @ up)
    if is_registered:
        return replace(upwards, name=FITTED_NAME, registered=True)
    origin = origin_in_file(centre, sensor)
    return replace(upwards, name=FITTED_NAME, origin=origin)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Places:
    """Places of the sensor in scans."""

    elsewhere: list[SensorPlace]  # In scans that are seen from elsewhere than the origin
    others: list[SensorPlace]  # In scans that look as if seen from the origin


def _places_elsewhere(upright: UprightScans) -> _Places | None:
    """Return the places of the sensor in all scans; None if too few are seen from elsewhere."""
    numbers = range(len(upright.scans))
    step = -(-len(numbers) // SCANS_OF_ORIGIN) or 1
    sample = numbers[::step]
    if not any(upright.is_doubtful(number) for number in sample):
        return None
    if not any(upright.place_elsewhere(number) for number in sample):
        return None
    doubtful = [number for number in numbers if upright.is_doubtful(number)]
    elsewhere = [place for place in map(upright.place_elsewhere, doubtful) if place]
    if len(elsewhere) < max(MIN_FOUND * len(doubtful), MIN_OUT_OF_PLACE * len(numbers), 1):
        return None
    certain = [number for number in numbers if number not in doubtful]
    others = [place for place in map(upright.place, certain) if place]
    return _Places(elsewhere=elsewhere, others=others)


def _common_up(places: Sequence[SensorPlace]) -> Double:
    """Return the median direction up (3,) on the side of the ground that most places show."""
    # The median of two opposite directions would be none.
    side = 1 if sum(float(np.sign(place.up[UPWARDS])) for place in places) >= 0 else -1
    directions = [place.up for place in places if np.sign(place.up[UPWARDS]) == side]
    up: Double = np.median(directions, axis=0)
    return up
