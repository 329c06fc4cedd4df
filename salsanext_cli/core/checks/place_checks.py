# SPDX-License-Identifier: MIT
"""Check whether the points of a scan are seen from where the sensor is supposed to be."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from salsanext_cli.core.geometry.beam_origin import MIN_SHARPNESS_ELSEWHERE, sharpness_at_origin
from salsanext_cli.core.geometry.evenness import is_fan, is_out_of_place, is_outdoors
from salsanext_cli.core.geometry.ground import (
    MAX_TILT_DEG,
    MIN_HEIGHT_M,
    SUPPORT,
    UPWARDS,
    Ground,
    find_ground,
)
from salsanext_cli.core.geometry.point_sample import few_points
from salsanext_cli.core.geometry.sensor_frame import in_sensor_frame, upright_rotation
from salsanext_cli.core.geometry.sensor_place import SensorPlace, find_place, origin_in_file
from salsanext_cli.core.records import Scan
from salsanext_cli.core.sensors.sensor import FITTED_NAME, ORIGIN, UP, Sensor

MIN_SHARE_OF_GROUND = 0.15  # Least share of near points on a ground that is not doubted
HINT_DIGITS = 2  # Digits of an origin in a hint, in metres
POINTS_OF_BEAMS = 16_384  # Points that show the beams
FLIPPED = np.array([1, -1, -1], np.float32)  # Turns z from down to up


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaceProblem:
    """Reason to doubt the position of a sensor."""

    problem: str
    remedy: str | None = None  # Lines of a sensor file; None if the position is unknown
    sensor: Sensor | None = None  # The sensor at its place; None if that is unknown


def place_problem(
    scan: Scan, sample: Scan, ground: Ground | None, sensor: Sensor
) -> PlaceProblem | None:
    """Return why the sensor seems to be elsewhere, None if it does not, or if it is not upright.

    Parameters
    ----------
    scan : Scan
        Scan in the frame of its file.
    sample : Scan
        Measured points of it in the frame of the sensor, without points on the vehicle.
    ground : Ground, optional
        Ground of the sample.
    sensor : Sensor
        Sensor that the scan is projected for.
    """
    if ground and ground.share >= MIN_SHARE_OF_GROUND and ground.tilt_deg > MAX_TILT_DEG:
        return None  # Another warning; the directions around have no meaning.
    if is_out_of_place(sample, nearby=False):
        unknown = "the points are not seen from their origin"
    elif _may_be_upside_down(sample, ground):
        unknown = "the ground may lie above the sensor"
    elif _is_unproven(scan, sample, ground, sensor):
        problem = "nothing in its part of the circle proves the fitted position of the sensor"
        return PlaceProblem(problem=problem)
    else:
        return None
    place = find_place(in_sensor_frame(scan, sensor))
    if place is not None and place.is_elsewhere:
        return _elsewhere(place, sensor)
    return PlaceProblem(problem=unknown) if place is None else None


def _is_unproven(scan: Scan, sample: Scan, ground: Ground | None, sensor: Sensor) -> bool:
    """Return whether a sensor was moved by a fit to scans of a fan that show no beams.

    The directions are as even from positions beside that of the sensor.
    """
    if sensor.name != FITTED_NAME or sensor.origin == ORIGIN or not is_fan(sample):
        return False
    return not shows_beams(scan, ground, sensor)


def shows_beams(scan: Scan, ground: Ground | None, sensor: Sensor) -> bool:
    """Return whether beams prove that a scan is seen from the origin of its sensor.

    Parameters
    ----------
    scan : Scan
        Scan in the frame of its file.
    ground : Ground, optional
        Its ground in the frame of the sensor.
    sensor : Sensor
        Sensor that the scan is projected for.
    """
    points = in_sensor_frame(few_points(scan, POINTS_OF_BEAMS), sensor).points
    above = MIN_HEIGHT_M - ground.height if ground else -np.inf
    objects = points[points[:, UPWARDS] > above]
    return sharpness_at_origin(objects) >= MIN_SHARPNESS_ELSEWHERE


def _may_be_upside_down(sample: Scan, ground: Ground | None) -> bool:
    """Return whether a scan without a ground has one on the other side."""
    share = ground.share if ground else 0.0
    if share >= MIN_SHARE_OF_GROUND or not is_outdoors(sample):
        return False
    other = find_ground(sample.points * FLIPPED, MAX_TILT_DEG)
    return other is not None and other.share > max(MIN_SHARE_OF_GROUND, SUPPORT * share)


def _elsewhere(place: SensorPlace, sensor: Sensor) -> PlaceProblem:
    """Return the problem of a sensor whose place in its supposed frame is known."""
    origin = origin_in_file(place.position, sensor, HINT_DIGITS)
    rotation = upright_rotation(np.asarray(sensor.up))
    up = (rotation.T @ place.up).round(HINT_DIGITS) + 0.0
    placed = replace(sensor, origin=origin, up=tuple(up.tolist()))
    x, y, z = place.position
    side = ", upside down" if place.up[UPWARDS] < 0 else ""
    problem = f"the points are seen from ({x:.1f}, {y:.1f}, {z:.1f}) m{side}, not from the origin"
    return PlaceProblem(problem=problem, remedy=lines_of_place(placed), sensor=placed)


def lines_of_place(sensor: Sensor) -> str:
    """Return the lines of a sensor file that state the mounting of a sensor."""
    origin = f"`origin = {list(sensor.origin)}`"
    return origin if sensor.up == UP else f"`up = {list(sensor.up)}` and {origin}"
