# SPDX-License-Identifier: MIT
"""Direction up and origin of a sensor in the frame of its files, from a few of its scans."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from salsanext_cli.geometry.beam_origin import find_origin, sharpness_at_origin
from salsanext_cli.geometry.ground import (
    MAX_TILT_DEG,
    MIN_HEIGHT_M,
    UPWARDS,
    finite_points,
    ground_of,
)
from salsanext_cli.geometry.projection import few_points, in_sensor_frame, upright_rotation
from salsanext_cli.geometry.sensor_place import (
    MIN_SHARPNESS,
    USUAL_HEIGHT_M,
    SensorPlace,
    find_place,
    is_out_of_place,
)
from salsanext_cli.records import Double, Float, Scan
from salsanext_cli.sensors.sensor import FITTED_NAME, ORIGIN, UP, Sensor

MIN_THICKNESS_M = 1.0  # Least height of the points above the ground of a sensor of several beams
MIN_OFFSET_M = 0.3  # Least distance from the origin that counts; optical centres are 0.2 m off
SCANS_OF_ORIGIN, POINTS_OF_ORIGIN = 4, 8192  # Scans that show the origin, and points of each
MIN_OUT_OF_PLACE = 1 / 3  # Least share of scans that are seen from elsewhere
MIN_FOUND = 0.5  # Least share of these whose sensor is found
REGISTERED_M = 2.0  # Least distance of a position from the median in scans of a moving sensor
DIGITS = 3


def fit_mounting(scans: Sequence[Scan], sensor: Sensor) -> Sensor:
    """Return the sensor with the direction up and the origin fitted to scans.

    The direction up changes if the ground of most scans is tilted by more than `MAX_TILT_DEG`. The
    origin changes if the points are seen from elsewhere, or if most scans show no ground at a usual
    height, as in the frame of a vehicle. It becomes the origin of the beams, if the scans show it;
    else the position from which the directions of the points are even; else the usual height if the
    ground passes through the origin. If the positions differ, as in scans that were registered to a
    map, each scan has its own origin.
    """
    sensor = replace(sensor, up=UP, origin=ORIGIN, registered=False)
    grounds = [ground for scan in scans if (ground := ground_of(scan))]
    tilted = [ground.up for ground in grounds if ground.tilt_deg > MAX_TILT_DEG]
    if len(tilted) > len(scans) / 2:
        up = np.median(tilted, axis=0)
        direction = (up / np.linalg.norm(up)).round(DIGITS)
        sensor = replace(sensor, name=FITTED_NAME, up=tuple(direction.tolist()))
    is_usual = not scans or sum(ground.is_usual for ground in grounds) >= len(scans) / 2
    upright = [in_sensor_frame(scan, sensor) for scan in scans]
    if is_usual:
        return _placed(upright, sensor)
    heights = [ground.height for ground in grounds]
    height = float(np.median(heights)) if heights else None
    points = _objects(upright, height)
    if sharpness_at_origin(points) > MIN_SHARPNESS:
        return sensor
    placed = _placed(upright, sensor, always=True)
    if placed != sensor:
        return placed
    position = _position_of_beams(points, height)
    if position is None or np.linalg.norm(position) < MIN_OFFSET_M:
        return sensor
    return _with_origin(sensor, position, upright_rotation(np.asarray(sensor.up)))


def _objects(upright: Sequence[Scan], height: float | None) -> Float:
    """Return points (N, 3) of upright scans without the ground, whose depth is `height` if known.

    The ground has most points near the sensor.
    """
    above = -np.inf if height is None else MIN_HEIGHT_M - height
    few = upright[:SCANS_OF_ORIGIN]
    rest = [scan.take(np.flatnonzero(scan.points[:, UPWARDS] > above)) for scan in few]
    return np.concatenate([finite_points(few_points(scan, POINTS_OF_ORIGIN)) for scan in rest])


def _position_of_beams(points: Float, height: float | None) -> Double | None:
    """Return the position (3,) of the sensor by upright objects around an origin at a height."""
    if (origin := find_origin(points)) is not None:
        return np.array(origin)
    flat = np.ptp(points[:, UPWARDS]) < MIN_THICKNESS_M if len(points) else True
    if flat or height is None or abs(height) > MIN_HEIGHT_M:
        return None
    return np.array([0.0, 0.0, USUAL_HEIGHT_M - height])


def _with_origin(sensor: Sensor, position: Double, rotation: Double) -> Sensor:
    """Return the sensor at a position (3,) in the frame that a rotation (3, 3) of the files has."""
    origin = (rotation.T @ position).round(DIGITS) + 0.0
    return replace(sensor, name=FITTED_NAME, origin=tuple(origin.tolist()))


def _placed(upright: Sequence[Scan], sensor: Sensor, *, always: bool = False) -> Sensor:
    """Return the sensor placed where upright scans are seen from, if that is not the origin.

    `always`: whether to search also in scans that could be seen from the origin.
    """
    few = upright[:: -(-len(upright) // SCANS_OF_ORIGIN) or 1]
    if not any(always or is_out_of_place(scan) for scan in few):
        return sensor
    if not any(_place_elsewhere(scan) for scan in few):
        return sensor
    doubtful = [scan for scan in upright if always or is_out_of_place(scan)]
    elsewhere = [place for scan in doubtful if (place := _place_elsewhere(scan))]
    others = len(upright) - len(doubtful)
    if len(elsewhere) < max(MIN_FOUND * len(doubtful), MIN_OUT_OF_PLACE * len(upright), 1):
        return sensor
    rotation = upright_rotation(np.asarray(sensor.up))
    proven = [place for place in elsewhere if place.shows_beams] or elsewhere
    centre = np.median([place.position for place in proven], axis=0)
    positions = np.array([place.position for place in elsewhere] + [np.zeros(3)] * others)
    registered = bool(np.hypot(*(positions - centre)[:, :UPWARDS].T).max() > REGISTERED_M)
    # The side that most scans show: the median of two opposite directions would be none.
    side = 1 if sum(float(np.sign(place.up[UPWARDS])) for place in elsewhere) >= 0 else -1
    ups = [place.up for place in elsewhere if np.sign(place.up[UPWARDS]) == side]
    up = np.median(ups, axis=0)
    if registered:  # Its frame is level or upside down.
        up = np.array([0, 0, np.sign(up[UPWARDS])])
    if up[UPWARDS] < 1:
        in_files = (rotation.T @ (up / np.linalg.norm(up))).round(DIGITS) + 0.0
        sensor = replace(sensor, name=FITTED_NAME, up=tuple(in_files.tolist()))
    if registered:
        return replace(sensor, name=FITTED_NAME, registered=True)
    return _with_origin(sensor, centre, rotation)


def _place_elsewhere(scan: Scan) -> SensorPlace | None:
    """Return the place of the sensor in an upright scan, None if it is unknown or as expected."""
    place = find_place(scan)
    return place if place is not None and place.is_elsewhere else None
