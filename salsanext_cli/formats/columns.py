# SPDX-License-Identifier: MIT
"""Scans from named columns, with the names and types of several programs."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.errors import FormatError, counted, shortened
from salsanext_cli.records import Float, Scan, normalised_intensity
from salsanext_cli.sensors.sensor import UNUSED_COLUMN

Columns = Mapping[str, npt.NDArray[Any]]  # Values by name, each (N,)

INTENSITY_NAMES = ("intensity", "scalar_intensity", "reflectivity", "reflectance", "remission", "i")
"""Names of the intensity, in lower case, in order of precedence."""
USED_NAMES = {"x", "y", "z", *INTENSITY_NAMES}  # Names of the columns of a scan
MAX_SHOWN_CHARACTERS = 300
USUAL_COLUMNS = ("x", "y", "z", "intensity")
MAX_UNNAMED_COLUMNS = 5  # Six may end in colours
MAX_DISTANCE_M = 10_000.0  # No LiDAR measures farther; up to it float32 holds millimetres


def scan_of(columns: Columns, path: Path, intensity_scale: float) -> Scan:
    """Return the scan of the columns x, y, z and intensity, which is 0 without a column."""
    points = coordinates(columns, path)
    _require_near_origin(points, path)
    require_no_matrix(points, path)
    known = _numbers(columns)
    named = [known[name] for name in INTENSITY_NAMES if name in known]
    intensity = named[0] if named else np.zeros(len(points), np.float32)
    return Scan(points, normalised_intensity(intensity, intensity_scale))


def coordinates(columns: Columns, path: Path) -> Float:
    """Return the columns x, y, z, in upper or lower case, as points (N, 3) float32 in metres."""
    by_axis = _numbers(columns)
    if missing := [axis for axis in "xyz" if axis not in by_axis]:
        raise FormatError(path, f"has columns {listed(columns)}", f"also {', '.join(missing)}")
    # Values beyond float32 become infinity, and signalling NaNs are valid: no measurements.
    with np.errstate(over="ignore", invalid="ignore"):
        return np.column_stack([by_axis[axis].astype(np.float32) for axis in "xyz"])


def _numbers(columns: Columns) -> Columns:
    return {name.lower(): values for name, values in columns.items() if values.dtype.kind in "iuf"}


def listed(columns: Columns) -> str:
    """Return the names of columns for an error."""
    return shortened(", ".join(columns) or "nothing", MAX_SHOWN_CHARACTERS)


def unnamed_columns(table: npt.NDArray[Any], names: tuple[str, ...], path: Path) -> Columns:
    """Return the columns of a table (N, C) by the names of a sensor, else the usual ones."""
    names = columns_of_width(table.shape[1], names, path)
    return {name: table[:, i] for i, name in enumerate(names) if name != UNUSED_COLUMN}


def columns_of_width(count: int, names: tuple[str, ...], path: Path) -> tuple[str, ...]:
    """Return the names of columns: a sensor's, else `USUAL_COLUMNS` and at most one more."""
    problem = f"has {counted(count, 'column')}"
    if names and count != len(names):
        expected = f"{len(names)}: {', '.join(names)}"
        raise FormatError(path, problem, expected, "name all columns with --columns")
    if names:
        return names
    if count < 3:
        hint = "pass the scan itself if these are values of its points, such as labels"
        raise FormatError(path, problem, "at least x, y, z", hint)
    if count > MAX_UNNAMED_COLUMNS:
        expected = f"3 to {MAX_UNNAMED_COLUMNS}: x, y, z, intensity and another one"
        hint = "name them, for example with --columns x,y,z,intensity,_,ring"
        raise FormatError(path, f"{problem} without names", expected, hint)
    return (*USUAL_COLUMNS, UNUSED_COLUMN)[:count]


def require_no_matrix(points: Float, path: Path) -> None:
    """Refuse a pose or camera matrix, whose three or four rows look like points."""
    rows = points[:3]
    with np.errstate(over="ignore", invalid="ignore"):
        if len(points) in (3, 4) and (
            np.allclose(rows @ rows.T, np.eye(3), atol=1e-3) or rows[2].tolist() == [0, 0, 1]
        ):
            problem = "looks like a pose or camera matrix"
            raise FormatError(path, problem, "the points of a scan", "pass the scans themselves")


def _require_near_origin(points: Float, path: Path) -> None:
    """Refuse points that are all far from a sensor at the origin."""
    for axis, values in zip("xy", points.T, strict=False):
        if (np.abs(values) <= MAX_DISTANCE_M).any():
            continue
        if len(finite := values[np.isfinite(values)]):
            problem = f"has map coordinates: {axis} from {finite.min():.0f} to {finite.max():.0f}"
            hint = "subtract the position of the sensor from the coordinates"
            raise FormatError(path, problem, "metres from a sensor at the origin", hint)
