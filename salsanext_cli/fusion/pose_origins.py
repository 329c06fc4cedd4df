# SPDX-License-Identifier: MIT
"""Origins of registered scans by the poses in the folder of their sequence."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

import numpy as np

from salsanext_cli.errors import NOTICE, SalsanextError
from salsanext_cli.formats import read_scan
from salsanext_cli.fusion.drive import poses_beside, readings_of
from salsanext_cli.geometry.scan_traits import sensor_of
from salsanext_cli.geometry.sensor_place import MIN_OFFSET_M
from salsanext_cli.records import Double
from salsanext_cli.results.paths import ScanFile
from salsanext_cli.results.recorded_origins import Origins
from salsanext_cli.results.selection import evenly_spaced
from salsanext_cli.sensors.sensor import Sensor

COMPARED_SCANS = 4  # Scans of a sequence that show whether its poses are those of the sensor

log = logging.getLogger(__name__)


def origins_by_poses(files: Sequence[ScanFile], sensor: Sensor) -> Origins:
    """Return the origins of registered scans by the poses of their sequences.

    Parameters
    ----------
    files : sequence of ScanFile
        Scans of any sequences.
    sensor : Sensor
        Sensor that was fitted to them.

    Returns
    -------
    dict of str to tuple of float
        Positions in metres by name of the scan. Sequences without usable poses are missing: those
        without a file, and those whose poses are not where the points show the sensor.
    """
    origins: Origins = {}
    if not sensor.has_registered:
        return origins
    ordered = sorted(files)
    for sequence, group in groupby(ordered, lambda file: file.sequence):
        scans = list(group)
        path = poses_beside(scans)
        positions = None if path is None else sensor_positions(path, scans, sensor)
        if positions is not None:
            log.log(NOTICE, "sequence %s: the origins of its scans are those of %s", sequence, path)
            for file, position in zip(scans, positions.tolist(), strict=True):
                origins[file.name] = tuple(position)
    return origins


def sensor_positions(path: Path, files: Sequence[ScanFile], sensor: Sensor) -> Double | None:
    """Return the positions (N, 3) of the poses in a file, None if scans are seen from elsewhere."""
    try:
        readings = readings_of(path, files)
    except SalsanextError as error:
        log.log(NOTICE, "%s is not used for the origins of the scans: %s", path, error.problem)
        return None
    numbers = evenly_spaced(range(len(files)), COMPARED_SCANS)
    seen_from = {number: _origin_by_points(files[number], sensor) for number in numbers}
    for poses in readings:
        positions: Double = poses[:, :3, 3]
        distances = [
            float(np.linalg.norm(positions[number] - origin))
            for number, origin in seen_from.items()
            if origin is not None
        ]
        if distances and max(distances) < MIN_OFFSET_M:
            return positions
    return None


def _origin_by_points(file: ScanFile, sensor: Sensor) -> Double | None:
    """Return the origin (3,) of a registered scan that its points show; None for other scans."""
    try:
        scan = read_scan(file.path, sensor)
    except SalsanextError:
        return None  # The run reports the error.
    of_scan = sensor_of(scan, sensor)
    return np.array(of_scan.origin) if of_scan.registered else None
