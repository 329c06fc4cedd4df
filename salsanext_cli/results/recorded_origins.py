# SPDX-License-Identifier: MIT
"""Origins of registered scans in an output folder, which the first stage finds for later ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from salsanext_cli.errors import FormatError
from salsanext_cli.files.reading import present
from salsanext_cli.formats.npy import read_array
from salsanext_cli.geometry.scan_traits import sensor_of
from salsanext_cli.records import Double, Scan
from salsanext_cli.results.manifest import Manifest
from salsanext_cli.results.paths import ORIGINS, ScanFile, output_path
from salsanext_cli.sensors.sensor import Sensor

Origins = dict[str, tuple[float, ...]]  # Position of the sensor in metres, by name of the scan


def sensor_of_result(out: Path, file: ScanFile, scan: Scan, sensor: Sensor) -> Sensor:
    """Return a fitted sensor as it saw a scan, by the origin that an output folder has.

    Parameters
    ----------
    out : Path
        Output folder.
    file, scan
        Scan with results in the folder, and its points in the frame of the file.
    sensor : Sensor
        Sensor that was fitted to the scans.

    Returns
    -------
    Sensor
        As of `sensor_of`, which finds an origin that is not recorded from the points.
    """
    return sensor_of(scan, sensor, recorded_origin(out, file, sensor))


def recorded_origin(out: Path, file: ScanFile, sensor: Sensor) -> tuple[float, ...] | None:
    """Return the origin of a registered scan in metres, None if none is recorded.

    Those of fused labels are in the folder of the labels of single scans.
    """
    if not sensor.has_registered:
        return None
    path = output_path(out, file.sequence, ORIGINS, file.stem)
    fused = Manifest(out).settings("fuse")
    if fused is not None and fused.fused_of is not None:
        path = output_path(out / fused.fused_of, file.sequence, ORIGINS, file.stem)
    if not present(path):
        return None
    position = read_array(path, "float64", (3,))
    if not np.isfinite(position).all():
        raise FormatError(path, "has no position", "three finite numbers in metres")
    return tuple(position.tolist())


def folders_of_origins(out: Path, stage: str, sensor: Sensor) -> tuple[str, ...]:
    """Return the folder that a stage records origins in; none if it has none to record.

    Origins of another stage in the output folder stay.
    """
    is_free = Manifest(out).owner(ORIGINS) in (None, stage)
    return (ORIGINS,) if sensor.has_registered and is_free else ()


def origin_array(sensor: Sensor) -> Double:
    """Return the origin (3,) of a scan, float64 in metres, as it is recorded."""
    return np.array(sensor.origin, np.float64)
