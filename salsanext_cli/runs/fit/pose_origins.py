# SPDX-License-Identifier: MIT
"""Origins of registered scans by the poses in the folder of their sequence."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path

import numpy as np

from salsanext_cli.core.errors import SalsanextError
from salsanext_cli.core.geometry.evenness import is_out_of_place
from salsanext_cli.core.geometry.sensor_frame import in_sensor_frame
from salsanext_cli.core.geometry.sensor_of_scan import sensor_of
from salsanext_cli.core.geometry.sensor_place import MIN_OFFSET_M
from salsanext_cli.core.poses import Poses
from salsanext_cli.core.records import Double, Origin, Origins
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.texts import counted, first_few
from salsanext_cli.io.formats import read_scan
from salsanext_cli.runs.fit.pose_files import poses_beside, position_in_file, readings_of
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.selection import evenly_spaced

COMPARED_SCANS = 5  # Scans of a sequence that show whether its poses are those of the sensor

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class OriginsByPoses:
    """Origins of registered scans by the poses of their sequences."""

    origins: Origins = field(default_factory=dict)
    lines: list[str] = field(default_factory=list)  # Which poses are used, and which are not


def origins_by_poses(
    files: Sequence[ScanFile], sensor: Sensor, listed: Sequence[ScanFile] = ()
) -> OriginsByPoses:
    """Return the origins of registered scans by the poses of their sequences.

    Parameters
    ----------
    files : sequence of ScanFile
        Scans of any sequences.
    sensor : Sensor
        Sensor that was fitted to them.
    listed : sequence of ScanFile, optional
        All scans of the sequences, of which the majority decides; by default `files`.

    Returns
    -------
    OriginsByPoses
        Positions in metres by name of the scan. Scans without usable poses are missing: those of
        sequences without a file, those of sequences most of whose poses are not where the points
        show the sensor, and those that are not seen from their pose.
    """
    by_poses = OriginsByPoses()
    if not sensor.has_registered:
        return by_poses
    for sequence, group in groupby(sorted(files), lambda file: file.sequence):
        scans = list(group)
        path = poses_beside(scans)
        if path is not None:
            scans_of_sequence = [file for file in listed if file.sequence == sequence]
            _add_sequence(by_poses, path, scans, sorted(scans_of_sequence) or scans, sensor)
    return by_poses


def _add_sequence(
    by_poses: OriginsByPoses,
    path: Path,
    scans: Sequence[ScanFile],
    scans_of_sequence: Sequence[ScanFile],
    sensor: Sensor,
) -> None:
    """Add the origins of the scans of a sequence by the poses in a file."""
    seen_from = _origins_by_points(scans_of_sequence, sensor)
    if not seen_from:
        return
    try:
        positions = _agreeing_positions(readings_of(path, scans_of_sequence), seen_from)
    except SalsanextError as error:
        by_poses.lines.append(f"{path} is not used for the origins of the scans: {error.problem}")
        return
    if positions is None:
        reason = "the points of most scans show the sensor elsewhere"
        by_poses.lines.append(f"{path} is not used for the origins of the scans: {reason}")
        return
    numbers = {file.name: number for number, file in enumerate(scans_of_sequence)}
    sequence = scans[0].sequence
    by_poses.lines.append(f"sequence {sequence}: the origins of its scans are those of {path}")
    unused = []
    for file in scans:
        seen = _seen_from(file, sensor, positions[numbers[file.name]])
        if seen is not None and seen.agrees:
            by_poses.origins[file.name] = seen.origin
        elif seen is not None:
            unused.append(file.name)
    if unused:
        poses = counted(len(unused), "pose")
        reason = "the points show the sensor elsewhere"
        line = f"{path}: {poses} not used for the origins, {reason}: {first_few(unused)}"
        by_poses.lines.append(line)


def sensor_positions(path: Path, files: Sequence[ScanFile], sensor: Sensor) -> Double | None:
    """Return the positions of the poses in a file, if most compared scans are seen from there.

    Parameters
    ----------
    path : Path
        File of poses.
    files : sequence of ScanFile
        The N scans of a sequence, sorted.
    sensor : Sensor
        Sensor that was fitted to them.

    Returns
    -------
    array (N, 3) of float64, or None
        In metres; None if most of the compared scans are seen from elsewhere, or none is
        registered.

    Raises
    ------
    SalsanextError
        If the file cannot be read or does not have poses of the scans.
    """
    return _agreeing_positions(readings_of(path, files), _origins_by_points(files, sensor))


def _agreeing_positions(
    readings: Sequence[Poses], seen_from: Mapping[int, Double]
) -> Double | None:
    """Return the positions (N, 3) of the poses that agree with most of the origins.

    `seen_from`: origin (3,) of compared scans, by their number. None if no poses agree with more
    than half of them.
    """
    best: Double | None = None
    most = len(seen_from) // 2
    for poses in readings:
        positions: Double = poses[:, :3, 3]
        agreeing = 0
        for number, origin in seen_from.items():
            distance = float(np.linalg.norm(positions[number] - origin))
            agreeing += int(distance < MIN_OFFSET_M)
        if agreeing > most:
            best = positions
            most = agreeing
    return best


def _origins_by_points(files: Sequence[ScanFile], sensor: Sensor) -> dict[int, Double]:
    """Return the origins (3,) that the points of a few registered scans show, by their number.

    They are in the coordinates of the files, as poses are.
    """
    origins = {}
    for number in evenly_spaced(range(len(files)), COMPARED_SCANS):
        try:
            scan = read_scan(files[number].path, sensor)
        except SalsanextError:
            continue  # The run reports the error.
        member = sensor_of(scan, sensor)
        if member.registered:
            origins[number] = position_in_file(member.origin, scan)
    return origins


@dataclass(frozen=True, slots=True, kw_only=True)
class _Position:
    """Position of a pose in the frame of a scan."""

    origin: Origin  # Metres
    agrees: bool  # Whether the scan looks as if seen from there


def _seen_from(file: ScanFile, sensor: Sensor, position: Double) -> _Position | None:
    """Return whether a registered scan is seen from a position (3,); None for other scans.

    `position` is in the coordinates of the file, in metres.
    """
    try:
        scan = read_scan(file.path, sensor)
    except SalsanextError:
        return None  # The run reports the error.
    origin = tuple((position - scan.notes.frame).tolist())
    member = sensor_of(scan, sensor, origin)
    if not member.registered:
        return None
    return _Position(origin=origin, agrees=not is_out_of_place(in_sensor_frame(scan, member)))
