# SPDX-License-Identifier: MIT
"""KITTI's raw scans, `.bin`, and those of nuScenes, `.pcd.bin`: little endian, no header."""

from pathlib import Path

import numpy as np

from salsanext_cli.errors import FormatError
from salsanext_cli.files.atomic import write_bytes
from salsanext_cli.files.reading import read_values, reading, size_of
from salsanext_cli.formats.columns import normalised_intensity, ring_of, scan_of, unnamed_columns
from salsanext_cli.formats.raw_records import (
    TEXT_BYTES,
    TEXT_SUFFIX,
    are_coordinates,
    are_float64,
    evident_count,
    likely_names,
    other_suffix,
)
from salsanext_cli.records import Float, Scan

COLUMNS = 4
"""x, y, z in metres, remission."""
COLUMNS_WITH_RING = 5
"""x, y, z, intensity, ring: the `.pcd.bin` files of nuScenes."""
ANEW = "write it anew as float32 x, y, z, intensity"


def read_bin(path: Path, columns: tuple[str, ...] = (), intensity_scale: float = 1.0) -> Scan:
    """Read a scan of float32 x, y, z, intensity and, in `.pcd.bin` files, ring, or of `columns`."""
    has_ring = path.name.lower().endswith(".pcd.bin")
    width = len(columns) or (COLUMNS_WITH_RING if has_ring else COLUMNS)
    values, size = _read_floats(path, width)
    if count := evident_count(values, width):
        raise _other_count(path, values, count, width)
    if size % (4 * width):
        remedy = "it is cut off or of another kind"
        raise FormatError(path, f"{size} bytes", _expected(width), remedy)
    table = values.reshape(-1, width)
    if columns:
        scan = scan_of(unnamed_columns(table, columns, path), path, intensity_scale)
    else:
        scan = Scan(
            np.ascontiguousarray(table[:, :3], np.float32),
            normalised_intensity(table[:, 3], intensity_scale),
            ring_of(table[:, 4]) if has_ring else None,
        )
    if not are_coordinates(scan.points):
        found = "numbers that are no coordinates in metres, or no float32"
        raise FormatError(path, found, f"{width} float32 per point", ANEW)
    return scan


def _read_floats(path: Path, width: int) -> tuple[Float, int]:
    """Read all float32 of a file of rows of so many, if it may be one; also return its size."""
    with reading(path) as file:
        size = size_of(file)
        if size == 0:
            raise FormatError(path, "is empty", _expected(width), "copy it again, or remove it")
        if suffix := other_suffix(file.read(TEXT_BYTES)):
            kind = "text" if suffix == TEXT_SUFFIX else f"a {suffix} file"
            remedy = f"rename it to {suffix} if it is a table of points"
            raise FormatError(path, f"is {kind}", f"{width} float32 per point", remedy)
        file.seek(0)
        values = read_values(file, path, "<f4", size // 4)
    if are_float64(values):
        raise FormatError(path, "holds float64", f"{width} float32 per point", ANEW)
    return values, size


def _expected(width: int) -> str:
    return f"a multiple of {4 * width} ({width} float32 per point)"


def _other_count(path: Path, values: Float, count: int, expected: int) -> FormatError:
    """Return the error of a file of another number of columns, with the names to try."""
    names = likely_names(values[: len(values) // count * count].reshape(-1, count))
    if names is None:
        found = f"holds records of {4 * count} bytes, not all float32"
        return FormatError(path, found, f"{expected} float32 per point", ANEW)
    remedy = f"name its columns, with --columns {','.join(names)} for example"
    suffix = {COLUMNS: ".bin", COLUMNS_WITH_RING: ".pcd.bin"}.get(count)
    if suffix and "intensity" in names[3:4]:
        remedy = f"give it the suffix {suffix}, or {remedy}"
    return FormatError(path, f"holds {count} columns", f"{expected} float32 per point", remedy)


def count_points(path: Path) -> int:
    """Return the number of points of a `.bin` file of four columns, from its size."""
    with reading(path) as file:
        return size_of(file) // (4 * COLUMNS)


def encode_bin(scan: Scan) -> bytes:
    """Return the content of a `.bin` file: float32 x, y, z, intensity of each point."""
    return np.column_stack([scan.points, scan.intensity]).astype("<f4", copy=False).tobytes()


def write_bin(path: Path, scan: Scan) -> None:
    """Write a scan as float32 x, y, z, intensity."""
    write_bytes(path, encode_bin(scan))
