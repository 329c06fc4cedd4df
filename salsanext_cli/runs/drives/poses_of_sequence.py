# SPDX-License-Identifier: MIT
"""Poses of the scans of a sequence, read from a file or from the scans, and checked."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from salsanext_cli.core.errors import FormatError, SalsanextError
from salsanext_cli.core.fusion.drive import Drive
from salsanext_cli.core.fusion.pose_checks import (
    MAX_MISFIT,
    best_reading,
    fitting_parts,
    require_fitting,
)
from salsanext_cli.core.geometry.sensor_frame import in_sensor_frame
from salsanext_cli.core.geometry.sensor_of_scan import sensor_of
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.poses import POSES
from salsanext_cli.core.records import Float, Origin
from salsanext_cli.core.sensors.sensor import UP, Sensor
from salsanext_cli.core.texts import percentage
from salsanext_cli.io.formats import read_scan
from salsanext_cli.runs.fit.pose_files import position_in_file, readings_of
from salsanext_cli.runs.scans.scan_file import ScanFile

OriginOf = Callable[[ScanFile], Origin | None]
"""Function that returns the origin of a registered scan, None if it is to be found from points."""

log = logging.getLogger(__name__)


def checked_drive(
    path: Path, files: Sequence[ScanFile], sensor: Sensor, origin_of: OriginOf
) -> Drive:
    """Return the drive by the poses in a file; refuse poses that do not fit the scans."""

    def read(index: int) -> Float:
        return measured_points(files[index], sensor, origin_of)

    readings = readings_of(path, files)
    counted_from = best_reading(readings, read)
    if counted_from == 1:
        reason = "scan names are line numbers counted from 1: the scans fit best"
        log.log(NOTICE, "%s: %s", path, reason)
    poses = readings[counted_from]
    return Drive(poses, require_fitting(path, poses, read))


def registered_drive(files: Sequence[ScanFile], sensor: Sensor, origin_of: OriginOf) -> Drive:
    """Return the drive of scans that are registered to one frame, by their sensor's positions.

    Scans that do not fit each other are refused.
    """
    poses = np.tile(np.eye(4), (len(files), 1, 1))
    for pose, file in zip(poses, files, strict=True):
        scan = read_scan(file.path, sensor)
        pose[:3, 3] = position_in_file(sensor_of(scan, sensor, origin_of(file)).origin, scan)

    def read(index: int) -> Float:
        return measured_points(files[index], sensor, origin_of)

    parts, misfit = fitting_parts(poses, read)
    if misfit > MAX_MISFIT:
        folder = files[0].path.parent
        problem = f"has {percentage(misfit, 0)} scans that do not fit the others"
        hint = f"move the scans to their sensor, and give its poses in {POSES}"
        raise FormatError(folder, problem, "scans in the frame of one map", hint)
    return Drive(poses, parts)


def is_registered(files: Sequence[ScanFile], sensor: Sensor, origin_of: OriginOf) -> bool:
    """Return whether the scans of a sequence are in the frame of a map, by the first one."""
    if not (sensor.has_registered and sensor.others):
        return sensor.registered
    scan = read_scan(files[0].path, sensor)
    return sensor_of(scan, sensor, origin_of(files[0])).registered


def points_of_drive(file: ScanFile, sensor: Sensor, origin_of: OriginOf) -> Float:
    """Read the points (N, 3) of a scan in the frame that its pose is for.

    It is that of the file, whose origin is moved to the sensor for registered scans.
    """
    scan = read_scan(file.path, sensor)
    if not sensor.has_registered:
        return scan.points
    member = sensor_of(scan, sensor, origin_of(file))
    if not member.registered:
        return scan.points
    return in_sensor_frame(scan, replace(member, up=UP)).points


def measured_points(file: ScanFile, sensor: Sensor, origin_of: OriginOf) -> Float:
    """Read the measured points (N, 3) of a scan by `points_of_drive`; none if it is unreadable."""
    try:
        points = points_of_drive(file, sensor, origin_of)
    except SalsanextError:
        return np.zeros((0, 3), np.float32)  # The run reports the error.
    return points[np.isfinite(points).all(axis=1)]
