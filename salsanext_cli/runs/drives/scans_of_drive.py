# SPDX-License-Identifier: MIT
"""The drive of the scans of a sequence: by their poses, by their registration, or computed."""

import logging
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from salsanext_cli.core.checks.finding import Finding
from salsanext_cli.core.checks.warning_codes import WarningCode
from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.fusion.drive import Drive
from salsanext_cli.core.fusion.registration import register
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.poses import POSES
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.wording import argument
from salsanext_cli.runs.drives.poses_of_sequence import (
    OriginOf,
    checked_drive,
    is_registered,
    measured_points,
    registered_drive,
)
from salsanext_cli.runs.fit.pose_files import poses_beside
from salsanext_cli.runs.fit.pose_origins import sensor_positions
from salsanext_cli.runs.scans.scan_file import ScanFile

log = logging.getLogger(__name__)


def drive_of_scans(
    files: Sequence[ScanFile], sensor: Sensor, origin_of: OriginOf, poses: Path | None = None
) -> Drive | None:
    """Return the drive of the scans of a sequence by their poses or their registration.

    Parameters
    ----------
    files : sequence of ScanFile
        Scans in the order of the drive.
    sensor : Sensor
        Sensor that was fitted to them.
    origin_of : callable
        Returns the origin of a registered scan, by which it was labelled.
    poses : Path, optional
        File of poses, by default that in the folder of the sequence.

    Returns
    -------
    Drive, or None
        None without a file of poses, if the scans are not registered.

    Raises
    ------
    SalsanextError
        If the poses cannot be used, or do not fit the scans.
    """
    if is_registered(files, sensor, origin_of):
        if poses is not None:
            require_positions(poses, files, sensor)
        return registered_drive(files, sensor, origin_of)
    path = poses or poses_beside(files)
    return checked_drive(path, files, sensor, origin_of) if path else None


def require_positions(poses: Path, files: Sequence[ScanFile], sensor: Sensor) -> None:
    """Refuse poses that are not those of the sensor in the frame of registered scans."""
    name = files[0].sequence
    if sensor_positions(poses, files, sensor) is None:
        problem = f"{poses} is not where the sensor is in most scans of sequence {name}"
        expected = "poses in the frame of the map that the scans are in"
        hint = f"omit {argument('poses')}: the scans are in one frame"
        raise UsageError(argument("poses"), problem, expected, hint)
    log.log(NOTICE, "sequence %s: its scans are in one frame, and %s agrees", name, poses)


def computed_drive(files: Sequence[ScanFile], sensor: Sensor, origin_of: OriginOf) -> Drive:
    """Compute the poses of the scans of a sequence; arguments as of `drive_of_scans`."""
    name = files[0].sequence
    log.log(NOTICE, "sequence %s: no %s, computing poses of its scans", name, POSES)
    return register(measured_points(file, sensor, origin_of) for file in files)


def drive_findings(files: Sequence[ScanFile], drive: Drive) -> list[Finding]:
    """Return the reasons to doubt a drive that is cut into parts."""
    parts = np.bincount(drive.parts)
    if (parts == 1).all():
        problem = "no two of its scans see common locations, so its labels do not change"
        hint = "check the poses and the order of the scans, or fuse a drive with overlapping scans"
        return [Finding(WarningCode.APART, problem, hint)]
    if len(parts) == 1:
        return []
    second = files[int(np.argmax(drive.parts == 1))].stem
    problem = f"its poses fit in {len(parts)} parts only, the second from {second} on"
    return [
        Finding(WarningCode.APART, problem, "check the poses; parts do not vote for each other")
    ]
