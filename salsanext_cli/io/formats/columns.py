# SPDX-License-Identifier: MIT
"""Scans from named columns, with the names and types of several programs."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.errors import FormatError, LabelError
from salsanext_cli.core.records import Double, FileNotes, Float, Origin, Scan, normalised_intensity
from salsanext_cli.core.sensors.sensor import MAX_COLUMNS, UNUSED_COLUMN
from salsanext_cli.core.texts import counted
from salsanext_cli.core.wording import argument, setting
from salsanext_cli.io.formats.field_names import AxisFields, fields_beside, intensity_among
from salsanext_cli.io.formats.split_fields import split_field
from salsanext_cli.io.formats.survey.local_frame import NO_SHIFT, local_frame, notice_frame

Columns = Mapping[str, npt.NDArray[Any]]
"""Values (N,) by the names of a file; numbers x, y and z at least, if `scan_of` takes them."""

USUAL_COLUMNS = ("x", "y", "z", "intensity")
MAX_UNNAMED_COLUMNS = 5  # Six may end in colours
SHIFT_HINT = "subtract the position of the sensor from the coordinates"
DOUBLE_HINT = "export it again with coordinates of double precision"
MAX_DISTANCE_M = 10_000.0  # No LiDAR measures farther; up to it float32 holds millimetres


def scan_of(
    columns: Columns,
    path: Path,
    intensity_scale: float,
    intensity_field: str = "",
    *,
    unread: Iterable[str] = (),
    missing_points: int = 0,
    may_be_map: bool = False,
) -> Scan:
    """Return the scan of named columns.

    Parameters
    ----------
    columns : mapping of str to (N,) array
        Values by the names of the file, in metres unless a name states another unit.
    path : Path
        The file, for errors.
    intensity_scale : float
        Divisor of the intensity, except bytes.
    intensity_field : str, optional
        Name of the column with the intensity; by default a usual one, and 0 without any.
    unread : iterable of str, optional
        Names of further fields of the file.
    missing_points : int, optional
        Number of points that the header of the file states, but that it lacks.
    may_be_map : bool
        Whether map coordinates are moved into a local frame; else they are refused.
    """
    frame = frame_of(columns, path) if may_be_map else NO_SHIFT
    notice_frame(frame)
    points = coordinates(columns, path, frame)
    require_near_origin(points, path, DOUBLE_HINT if may_be_map else SHIFT_HINT)
    require_no_matrix(points, path)
    numbers = _numbers(columns)
    name = intensity_among(list(numbers), intensity_field, path)
    intensity = np.zeros(len(points), np.float32) if name is None else numbers[name]
    fields = tuple(field for field in fields_beside([*numbers, *unread]) if field != name)
    scaled = normalised_intensity(intensity, intensity_scale)
    split = split_field(numbers)
    notes = FileNotes(fields=fields, missing_points=missing_points, split=split, frame=frame)
    return Scan(points, scaled, notes)


def frame_of(columns: Columns, path: Path) -> Origin:
    """Return the origin of the local frame of coordinates in float64, `NO_SHIFT` of others."""
    numbers = _numbers(columns)
    axes = AxisFields.among(list(numbers) or list(columns), path)
    values = [numbers[name] for name in axes.names]
    if any(column.dtype != np.float64 for column in values):
        return NO_SHIFT
    with np.errstate(invalid="ignore"):  # Signalling NaNs are valid: no measurements.
        return local_frame(np.column_stack(values) * np.array(axes.metres))


def coordinates(columns: Columns, path: Path, frame: Origin = NO_SHIFT) -> Float:
    """Return the coordinates of points.

    Parameters
    ----------
    columns : mapping of str to (N,) array
        Columns of a file, x, y, z in upper or lower case among them.
    path : Path
        The file, for errors.
    frame : 3 floats
        Position in metres that is subtracted.

    Returns
    -------
    (N, 3) float32
        In metres.
    """
    numbers = _numbers(columns)
    axes = AxisFields.among(list(numbers) or list(columns), path)
    # Values beyond float32 become infinity, and signalling NaNs are valid: no measurements.
    with np.errstate(over="ignore", invalid="ignore"):
        parts = zip(axes.names, axes.metres, frame, strict=True)
        return np.column_stack([_in_metres(numbers[name], m, shift) for name, m, shift in parts])


def coordinates_of_edited(columns: Columns, path: Path, frame: Origin) -> Float:
    """Return the coordinates of an edited cloud in the frame of its scan: (N, 3) float32, metres.

    Tools save a cloud in map coordinates, or in `frame`; float64 values far from 0 are the former.
    """
    is_map = frame_of(columns, path) != NO_SHIFT
    return coordinates(columns, path, frame if is_map else NO_SHIFT)


def _in_metres(values: npt.NDArray[Any], metres: float, shift: float) -> Float:
    if metres != 1:
        values = values * np.float64(metres)
    return (values - shift if shift else values).astype(np.float32)


def _numbers(columns: Columns) -> Columns:
    return {name: values for name, values in columns.items() if values.dtype.kind in "iuf"}


def unnamed_columns(table: npt.NDArray[Any], names: tuple[str, ...], path: Path) -> Columns:
    """Return the columns of a table without names.

    Parameters
    ----------
    table : (N, C) array
        Values.
    names : tuple of str
        Names of the columns as a sensor states them; empty for the usual ones.
    path : Path
        The file, for errors.

    Returns
    -------
    Columns
        Values (N,) of the named columns.
    """
    names = columns_of_width(table.shape[1], names, path)
    return {name: table[:, i] for i, name in enumerate(names) if name != UNUSED_COLUMN}


def columns_of_width(count: int, names: tuple[str, ...], path: Path) -> tuple[str, ...]:
    """Return the names of columns: those of a sensor, else `USUAL_COLUMNS` and at most one more.

    Parameters
    ----------
    count : int
        Number of columns.
    names : tuple of str
        Names as a sensor states them; empty for the usual ones.
    path : Path
        The file, for errors.

    Returns
    -------
    tuple of str

    Raises
    ------
    FormatError
        If the number of columns does not fit.
    """
    problem = f"has {counted(count, 'column')}"
    if names and count != len(names):
        expected = f"{len(names)}: {', '.join(names)}"
        hint = f"omit {argument('columns')}"
        if count >= 3:
            hint = f"name all columns, for example with {setting('columns', names_to_try(count))}"
        raise FormatError(path, problem, expected, hint)
    if names:
        return names
    if count < 3:
        hint = "pass the scan itself if these are values of its points, such as labels"
        raise FormatError(path, problem, "at least x, y, z", hint)
    if count > MAX_UNNAMED_COLUMNS:
        expected = f"3 to {MAX_UNNAMED_COLUMNS}: x, y, z, intensity and another one"
        hint = f"name them, for example with {setting('columns', names_to_try(count))}"
        if count > MAX_COLUMNS:
            hint = f"save at most {MAX_COLUMNS} columns, one row per point"
        raise FormatError(path, f"{problem} without names", expected, hint)
    return (*USUAL_COLUMNS, UNUSED_COLUMN)[:count]


def names_to_try(count: int) -> str:
    """Return as many names as a file has columns, for `columns`."""
    return ",".join((*USUAL_COLUMNS, *count * [UNUSED_COLUMN])[:count])


def require_no_matrix(points: Float, path: Path) -> None:
    """Refuse a pose or camera matrix, whose three or four rows look like points."""
    rows = points[:3]
    with np.errstate(over="ignore", invalid="ignore"):
        if len(points) in (3, 4) and (
            np.allclose(rows @ rows.T, np.eye(3), atol=1e-3) or rows[2].tolist() == [0, 0, 1]
        ):
            problem = "looks like a pose or camera matrix"
            raise FormatError(path, problem, "the points of a scan", "pass the scans themselves")


def require_near_origin(points: Float | Double, path: Path, hint: str = SHIFT_HINT) -> None:
    """Refuse points (N, 3) in metres that are all far from a sensor at the origin."""
    for axis, values in zip("xy", points.T, strict=False):
        if (np.abs(values) <= MAX_DISTANCE_M).any():
            continue
        finite = values[np.isfinite(values)]
        if len(finite):
            problem = f"has map coordinates: {axis} from {finite.min():.0f} to {finite.max():.0f}"
            raise FormatError(path, problem, "metres from a sensor at the origin", hint)


def other_number(points: int, labels: int, path: Path) -> LabelError:
    """Return the error of a file with another number of points than labels."""
    expected = f"{labels:,}, the number of labels"
    return LabelError(path, f"has {counted(points, 'point')}", expected, "predict again")
