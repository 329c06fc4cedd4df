# SPDX-License-Identifier: MIT
"""Direction up and place of a sensor in the frame of its files, from a few of its scans."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from salsanext_cli.fitting.ground import MIN_HEIGHT_M, TOLERANCE_M, Ground, find_ground
from salsanext_cli.fitting.origin_fit import find_origin
from salsanext_cli.geometry.few_points import few_points
from salsanext_cli.geometry.mounting import in_sensor_frame, upright_rotation
from salsanext_cli.records import Float, Scan
from salsanext_cli.sensors.sensor import FITTED_NAME, ORIGIN, UP, Sensor

MAX_TILT_DEG = 8.0
"""Largest angle between the ground's normal and z of a sensor that stands upright; real ones had up
to 5°. A vehicle stands on its street, however steep that is."""
UPSIDE_DOWN_DEG = 155.0
"""Least angle of a ground above the sensor."""
SUPPORT = 1.5
"""Factor by which a tilted ground must have more points than the best one that is not."""
SUPPORT_OF_CEILING = 4.0
"""The same of a ground above the sensor with a level one below it: ceilings of simulated rooms had
up to 3.7 times the points of the floor; below sensors that hang over a street was none."""
HEIGHTS_M = (1.0, 2.6)
"""Least and largest height of a sensor on a vehicle; those of the real scans were 1.4 to 2.1."""
USUAL_HEIGHT_M = 1.75
"""Height that is assumed where the origin is on the ground and the scans do not tell it."""
MIN_THICKNESS_M = 1.0
"""Least extent upwards of points above the ground; less, a scanner of one plane sees that plane."""
MIN_OFFSET_M = 0.3
"""Least distance of a sensor from the origin that counts; optical centres lie 0.2 m off it."""
SCANS_OF_ORIGIN, POINTS_OF_ORIGIN = 4, 8192
"""Scans that the place of the sensor is sought with, and points of each."""
DIGITS = 3


def fit_mounting(scans: Sequence[Scan], sensor: Sensor) -> Sensor:
    """Return the sensor with the direction up and the origin of scans where they differ much.

    The direction up changes where the ground of most scans is tilted by more than `MAX_TILT_DEG`,
    the heading as little as that allows.
    The origin changes where most scans show no ground at a height of `HEIGHTS_M`, as in the frame
    of a vehicle: to the place that the beams come from, if that is seen; else to the usual height
    if the ground passes through the origin, where no sensor can be.

    `scans`: of one sensor; `sensor`: that of the weights; its own mounting, of other scans, is
    forgotten.
    """
    sensor = replace(sensor, up=UP, origin=ORIGIN)
    grounds = [ground for scan in scans if (ground := ground_of(scan))]
    tilted = [ground.up for ground in grounds if ground.tilt_deg > MAX_TILT_DEG]
    if len(tilted) > len(scans) / 2:
        up = np.median(tilted, axis=0)
        sensor = replace(sensor, name=FITTED_NAME, up=_direction(up))
    heights = [ground.height for ground in grounds]
    usual = sum(HEIGHTS_M[0] <= height <= HEIGHTS_M[1] for height in heights)
    if not scans or usual >= len(scans) / 2:
        return sensor
    place = _place(scans, sensor, float(np.median(heights)) if heights else None)
    if place is None or np.linalg.norm(place) < MIN_OFFSET_M:
        return sensor
    in_files = upright_rotation(np.asarray(sensor.up)).T @ place
    return replace(sensor, name=FITTED_NAME, origin=tuple(in_files.round(DIGITS).tolist()))


def _place(
    scans: Sequence[Scan], sensor: Sensor, height: float | None
) -> tuple[float, float, float] | None:
    """Return the place of the sensor in upright scans whose origin is at a height, if known."""
    upright = [in_sensor_frame(scan, sensor) for scan in scans[:SCANS_OF_ORIGIN]]
    points = np.concatenate([_finite(few_points(scan, POINTS_OF_ORIGIN)) for scan in upright])
    if height is not None:
        points = points[points[:, 2] > MIN_HEIGHT_M - height]
    if (place := find_origin(points)) is not None:
        return place
    flat = np.ptp(points[:, 2]) < MIN_THICKNESS_M if len(points) else True
    if flat or height is None or abs(height) > MIN_HEIGHT_M:
        return None
    return 0.0, 0.0, USUAL_HEIGHT_M - height


def ground_of(scan: Scan) -> Ground | None:
    """Find the ground in a scan, from some of its points.

    A tilted one must be likelier than the best level one, and at the height of a sensor on a
    vehicle, or pass through the origin; much likelier if it could be the ceiling of a room.
    """
    points = _finite(few_points(scan))
    ground = find_ground(points)
    if ground is None or ground.tilt_deg <= MAX_TILT_DEG:
        return ground
    level = find_ground(points, MAX_TILT_DEG)
    usual = HEIGHTS_M[0] <= ground.height <= HEIGHTS_M[1] or ground.height < MIN_HEIGHT_M
    in_room = level and level.height > TOLERANCE_M and ground.tilt_deg > UPSIDE_DOWN_DEG
    support = SUPPORT_OF_CEILING if in_room else SUPPORT
    likely = level is None or ground.share > support * level.share
    return ground if usual and likely else level


def _direction(vector: npt.NDArray[np.float64]) -> tuple[float, ...]:
    return tuple((vector / np.linalg.norm(vector)).round(DIGITS).tolist())


def _finite(scan: Scan) -> Float:
    return scan.points[np.isfinite(scan.points).all(axis=1)]
