# SPDX-License-Identifier: MIT
"""Headerless little-endian files of scans, `.bin`, of KITTI and nuScenes.

Files of anything but points are refused.
"""

from dataclasses import dataclass
from io import BufferedReader
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.errors import FormatError
from salsanext_cli.core.notices import notice_once
from salsanext_cli.core.records import Float, Scan, normalised_intensity
from salsanext_cli.core.sensors.sensor import UNUSED_COLUMN
from salsanext_cli.core.wording import argument, setting
from salsanext_cli.io.files.reading import read_values, reading, size_of
from salsanext_cli.io.formats.columns import (
    columns_of_width,
    names_to_try,
    require_near_origin,
    require_no_matrix,
    scan_of,
    unnamed_columns,
)
from salsanext_cli.io.formats.evidence.column_evidence import (
    empty_places,
    evident_count,
    have_signs_of_coordinates,
)
from salsanext_cli.io.formats.evidence.file_kinds import TEXT_BYTES, TEXT_SUFFIX, other_kind
from salsanext_cli.io.formats.evidence.plane_evidence import are_planes
from salsanext_cli.io.formats.evidence.value_types import (
    are_coordinates,
    are_float16,
    are_float64,
    are_halves,
    blocks_of_pairs,
)

INTENSITY = "intensity"
COLUMNS = 4  # x, y, z in metres, remission
COLUMNS_WITH_RING = 5  # x, y, z, intensity, ring: the `.pcd.bin` files of nuScenes
REWRITE = "rewrite it as float32 x, y, z, intensity"
REWRITE_FLOAT16 = "np.fromfile(FILE, np.float16).astype(np.float32).tofile(NEW) converts it"
REWRITE_ROWS = "np.fromfile(FILE, np.float32).reshape(COLUMNS, -1).T.tofile(NEW) converts it"
FLOAT32_BYTES = 4


@dataclass(frozen=True, slots=True)
class BinTable:
    """Points of a `.bin` file, and how they are stored."""

    values: npt.NDArray[np.floating[Any]]  # (N, C) float32 or float64
    is_planar: bool  # Whether all values of a column follow each other

    def encode(self, rows: npt.NDArray[np.floating[Any]]) -> bytes:
        """Return the content of a file of the same layout with other rows (K, C)."""
        return (rows.T if self.is_planar else rows).tobytes()


def read_bin(
    path: Path,
    columns: tuple[str, ...] = (),
    intensity_scale: float = 1.0,
    intensity_field: str = "",
) -> Scan:
    """Read a scan.

    Parameters
    ----------
    path : Path
        The `.bin` file.
    columns : tuple of str
        Names of its columns; by default x, y, z, intensity and, in `.pcd.bin` files, ring.
    intensity_scale : float
        Divisor of the intensity.
    intensity_field : str
        Name of the column with the intensity; by default the usual one.

    Returns
    -------
    Scan
        N points, in the order of the file.

    Raises
    ------
    FormatError
        If the file is damaged, or contains anything but points.
    """
    if intensity_field and not columns:
        problem = f"has no names, so no {argument('intensity_field')}"
        hint = f"name the columns: {setting('columns', 'x,y,z,intensity')} for example"
        raise FormatError(path, problem, "names of columns", hint)
    table = read_table(path, columns)
    if columns:
        named = unnamed_columns(table.values, columns, path)
        scan = scan_of(named, path, intensity_scale, intensity_field)
    else:
        require_near_origin(table.values[:, :3], path)
        with np.errstate(over="ignore", invalid="ignore"):
            points = np.ascontiguousarray(table.values[:, :3], np.float32)
        scan = Scan(points, normalised_intensity(table.values[:, 3], intensity_scale))
        require_no_matrix(points, path)
    if not are_coordinates(scan.points):
        raise _no_coordinates(path, table.values.shape[1])
    if not (columns or table.is_planar):
        _require_intensity(table.values, path)
    return scan


def read_table(path: Path, columns: tuple[str, ...] = ()) -> BinTable:
    """Read the values of a `.bin` file in rows of the named or the usual columns."""
    width = len(columns) or default_width(path)
    values, size = _read_values(path, width)
    with np.errstate(over="ignore", invalid="ignore"):
        rounded = values.astype(np.float32, copy=False)
    fits = are_planes(rounded, width)
    if fits is not None:
        if not fits:
            expected = f"rows of {width} float32 per point"
            raise FormatError(path, "is stored column by column", expected, REWRITE_ROWS)
        notice_once(f".bin files that store {width} columns one after the other are read as rows")
        return BinTable(np.ascontiguousarray(values.reshape(width, -1).T), is_planar=True)
    count = evident_count(rounded, width)
    if count:
        if are_coordinates(rounded[:, None]):
            raise _other_count(path, count, width)
        raise _no_coordinates(path, width)
    if size % (values.itemsize * width):
        hint = f"copy it again; if it has other columns, name them with {argument('columns')}"
        raise FormatError(path, f"has {size} bytes", _multiple_of(width, values.itemsize), hint)
    table = values.reshape(-1, width)
    places = empty_places(rounded, width)
    if places is not None and not columns and np.isfinite(rounded).all():
        empty = f"{int(places.sum())} of every {len(places)} rows of .bin files without values"
        named = setting("columns", names_to_try(len(places) * width))
        notice_once(f"{empty}: unmeasured returns, or further columns: {named}")
    return BinTable(table, is_planar=False)


def _require_intensity(table: npt.NDArray[np.floating[Any]], path: Path) -> None:
    """Refuse rows (N, C) without names whose intensities look like coordinates."""
    width = table.shape[1]
    names = columns_of_width(width, (), path)
    if INTENSITY not in names:
        return
    values = table.ravel()
    if have_signs_of_coordinates(values, width, names.index(INTENSITY)):
        other_names = ",".join(UNUSED_COLUMN if name == INTENSITY else name for name in names)
        by_column = f"{REWRITE_ROWS} if it is stored column by column"
        named = f"{setting('columns', ','.join(names))} if these are intensities"
        hint = f"{by_column}; {named}; if not, {setting('columns', other_names)}"
        problem = "has coordinates as its intensities"
        raise FormatError(path, problem, f"{width} float32 per point", hint)


def default_width(path: Path) -> int:
    """Return the number of columns of a `.bin` file, 5 for `.pcd.bin`."""
    return COLUMNS_WITH_RING if path.name.lower().endswith(".pcd.bin") else COLUMNS


def _read_values(path: Path, width: int) -> tuple[npt.NDArray[np.floating[Any]], int]:
    """Return the float32 or float64 values (M,) of a file, and its size in bytes."""
    with reading(path) as file:
        size = _size_of_values(file, path, width)
        file.seek(0)
        values = read_values(file, path, "<f4", size // FLOAT32_BYTES)
    if are_float64(values):
        notice_once(".bin files of float64 are read, and rounded to float32")
        return values.view("<f8"), size
    if are_float16(values, width):
        raise FormatError(path, "looks like float16", f"{width} float32 per point", REWRITE_FLOAT16)
    return values, size


def _size_of_values(file: BufferedReader, path: Path, width: int) -> int:
    """Return the size of a file in bytes; refuse an empty one, and one of another format."""
    size = size_of(file)
    if size == 0:
        raise FormatError(path, "is empty", _multiple_of(width), "copy it again, or remove it")
    kind = other_kind(file.read(TEXT_BYTES))
    if kind:
        raise _other_kind_error(path, kind, width)
    return size


def _other_kind_error(path: Path, kind: str, width: int) -> FormatError:
    """Return the error of a file of another kind, which is a suffix or a name."""
    expected = f"{width} float32 per point"
    if not kind.startswith("."):
        return FormatError(path, f"is {kind}", expected, REWRITE)
    name = "text" if kind == TEXT_SUFFIX else f"a {kind} file"
    return FormatError(path, f"is {name}", expected, f"rename it to {kind} if it contains points")


def _multiple_of(width: int, itemsize: int = 4) -> str:
    kind = f"float{8 * itemsize}"
    return f"a multiple of {itemsize * width}: {width} {kind} per point"


def _no_coordinates(path: Path, width: int) -> FormatError:
    problem = "contains numbers that are not float32, or not coordinates in metres"
    return FormatError(path, problem, f"{width} float32 per point", REWRITE)


def _other_count(path: Path, count: int, expected: int) -> FormatError:
    """Return the error of a file with another number of columns, with names to try."""
    hint = f"name its columns, for example with {setting('columns', names_to_try(count))}"
    suffixes = {COLUMNS: ".bin", COLUMNS_WITH_RING: ".pcd.bin"}
    if count == default_width(path):
        hint = f"omit {argument('columns')}"
    elif count in suffixes:
        hint = f"rename it to {suffixes[count]}, or {hint}"
    return FormatError(path, f"has {count} columns", f"{expected} per point", hint)


def count_points(path: Path) -> int:
    """Return the number of points of a `.bin` file of the usual columns, float32 or float64.

    Only a sample of the values is read: their type and the size of the file determine the number.
    """
    width = default_width(path)
    with reading(path) as file:
        size = _size_of_values(file, path, width)
        is_float64 = size // FLOAT32_BYTES % 2 == 0 and are_halves(_sampled_pairs(file, path, size))
    return size // (FLOAT32_BYTES * (1 + is_float64) * width)


def _sampled_pairs(file: BufferedReader, path: Path, size: int) -> Float:
    """Read the pairs of float32 values (M, 2) that show whether all are halves of float64."""
    blocks = []
    for block in blocks_of_pairs(size // (2 * FLOAT32_BYTES)):
        file.seek(2 * FLOAT32_BYTES * block.start)
        blocks.append(read_values(file, path, "<f4", 2 * len(block)))
    return np.concatenate(blocks).reshape(-1, 2)


def encode_bin(scan: Scan) -> bytes:
    """Return the content of a `.bin` file: float32 x, y, z, intensity of each point."""
    return np.column_stack([scan.points, scan.intensity]).astype("<f4", copy=False).tobytes()
