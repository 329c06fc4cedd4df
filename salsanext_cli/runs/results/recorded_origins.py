# SPDX-License-Identifier: MIT
"""Origins of registered scans in an output folder, which the first stage finds for later ones."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from salsanext_cli.core.errors import FormatError
from salsanext_cli.core.geometry.sensor_of_scan import sensor_of
from salsanext_cli.core.records import Double, Origin, Origins, Scan
from salsanext_cli.core.sensors.sensor import ORIGIN, Sensor
from salsanext_cli.io.files.reading import present
from salsanext_cli.io.formats.npy import read_array
from salsanext_cli.runs.results.folder_names import ORIGINS
from salsanext_cli.runs.results.manifest import Manifest
from salsanext_cli.runs.results.output_paths import output_path
from salsanext_cli.runs.results.output_run import OutputRun
from salsanext_cli.runs.scans.scan_file import ScanFile


def sensor_of_result(out: Path, file: ScanFile, scan: Scan, sensor: Sensor) -> Sensor:
    """Return a fitted sensor as it saw a scan, by the origin that an output folder has.

    Parameters
    ----------
    out : Path
        Output folder.
    file : ScanFile
        Scan with results in the folder.
    scan : Scan
        Its points in the frame of the file.
    sensor : Sensor
        Sensor that was fitted to the scans.

    Returns
    -------
    Sensor
        As of `sensor_of`, which finds an origin that is not recorded from the points.
    """
    return sensor_of(scan, sensor, recorded_origin(out, file, sensor))


def recorded_origin(out: Path, file: ScanFile, sensor: Sensor) -> Origin | None:
    """Return the origin of a registered scan in metres, None if none is recorded.

    Those of fused labels are in the folder of the labels of single scans.
    """
    if not sensor.has_registered:
        return None
    folder = out
    fused = Manifest(out).settings("fuse")
    if fused is not None and fused.fused_of is not None:
        folder = out / fused.fused_of
    path = output_path(folder, file.sequence, ORIGINS, file.stem)
    if not present(path):
        return None
    stage = Manifest(folder).owner(ORIGINS) or "predict"
    hint = f"delete it and run `salsanext {stage}` again, which writes it"
    try:
        position = read_array(path, "float64", (3,))
    except FormatError as error:
        raise FormatError(path, error.problem, error.expected, hint) from error
    if not np.isfinite(position).all():
        raise FormatError(path, "has no position", "three finite numbers in metres", hint)
    return tuple(position.tolist())


def recorded_origins(out: Path, sensor: Sensor) -> Callable[[ScanFile], Origin | None]:
    """Return the function `recorded_origin` of the scans in an output folder."""
    return lambda file: recorded_origin(out, file, sensor)


def origin_in_run(
    run: OutputRun, file: ScanFile, sensor: Sensor, by_poses: Origins
) -> Origin | None:
    """Return the origin of a registered scan in metres that a run uses.

    Parameters
    ----------
    run : OutputRun
        Run of a stage, whose folder may have recorded origins.
    file : ScanFile
        Scan with results to write.
    sensor : Sensor
        Sensor that was fitted to the scans.
    by_poses : dict of str to tuple of float
        Origins by poses, by name of the scan.

    Returns
    -------
    tuple of float, or None
        The recorded origin unless the run replaces it, else the one by poses; None without both.
    """
    recorded = None
    if not are_replaced(run.root, run.stage, overwrite=run.overwrite):
        recorded = recorded_origin(run.root, file, sensor)
    return by_poses.get(file.name) if recorded is None else recorded


def are_replaced(out: Path, stage: str, *, overwrite: bool) -> bool:
    """Return whether a run of a stage replaces the origins that are recorded in its folder.

    Origins of another stage in the output folder stay, and the run uses them.
    """
    return overwrite and Manifest(out).owner(ORIGINS) in (None, stage)


def folders_of_origins(out: Path, stage: str, sensor: Sensor) -> tuple[str, ...]:
    """Return the folder that a stage records origins in; none if it has none to record.

    Origins of another stage in the output folder stay.
    """
    is_free = Manifest(out).owner(ORIGINS) in (None, stage)
    return (ORIGINS,) if sensor.has_registered and is_free else ()


def origin_array(origin: Origin | None) -> Double:
    """Return the origin (3,) of a scan, float64 in metres, as it is recorded."""
    return np.array(ORIGIN if origin is None else origin, np.float64)
