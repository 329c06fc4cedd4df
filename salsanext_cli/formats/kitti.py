# SPDX-License-Identifier: MIT
"""KITTI's raw files: `.bin` scans and `.label` labels, little endian, no header."""

from pathlib import Path

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes import RawIds
from salsanext_cli.errors import FormatError, LabelError
from salsanext_cli.formats.columns import normalised_intensity, ring_of, scan_of, unnamed_columns
from salsanext_cli.formats.raw_records import (
    MIN_TEXT_BYTES,
    TEXT_BYTES,
    TEXT_SUFFIX,
    are_coordinates,
    are_float64,
    other_suffix,
)
from salsanext_cli.formats.reading import read_values, reading, size_of
from salsanext_cli.records import Float, Scan

COLUMNS = 4
"""x, y, z in metres, remission."""
COLUMNS_WITH_RING = 5
"""x, y, z, intensity, ring: the `.pcd.bin` files of nuScenes."""
REMEDIES = {
    COLUMNS: "give a file of 4 columns the suffix .bin",
    COLUMNS_WITH_RING: "give a file of 5 columns the suffix .pcd.bin, or "
    "name them, with --columns x,y,z,intensity,ring",
    6: "name its columns, with --columns x,y,z,intensity,_,_ for example",
}
"""Advice for a file with that number of columns where another is expected."""
ANEW = "write it anew as float32 x, y, z, intensity"
MAX_CLASS = 0xFFFF
"""Largest label of four bytes without an instance."""


def read_bin(path: Path, *, columns: tuple[str, ...] = (), intensity_scale: float = 1.0) -> Scan:
    """Read a scan of float32 x, y, z, intensity and, in `.pcd.bin` files, ring.

    Parameters
    ----------
    path : Path
        The file.
    columns : tuple of str
        Names of other columns; empty for those above.
    intensity_scale : float
        Divides the intensity.

    Raises
    ------
    FormatError
        If the file cannot be read, is empty or truncated, or evidently holds something else.
    """
    has_ring = path.name.lower().endswith(".pcd.bin")
    width = len(columns) or (COLUMNS_WITH_RING if has_ring else COLUMNS)
    values = _read_floats(path, width)
    if not columns and (fitting := _evident_columns(values, width)):
        raise FormatError(
            path, f"holds {fitting} columns", f"{width} float32 per point", REMEDIES[fitting]
        )
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


def _read_floats(path: Path, width: int) -> Float:
    """Read all float32 of a file of rows of so many, if it may be one."""
    with reading(path) as file:
        size = size_of(file)
        expected = f"a multiple of {4 * width} ({width} float32 per point)"
        if size == 0:
            raise FormatError(path, "is empty", expected, "copy it again, or remove it")
        start = file.read(TEXT_BYTES + 1)
        if size >= MIN_TEXT_BYTES and (suffix := other_suffix(start)):
            kind = "text" if suffix == TEXT_SUFFIX else f"a {suffix} file"
            remedy = f"rename it to {suffix} if it is a table of points"
            raise FormatError(path, f"is {kind}", f"{width} float32 per point", remedy)
        file.seek(0)
        values = read_values(file, path, "<f4", size // 4)
    if are_float64(values):
        raise FormatError(path, "holds float64", f"{width} float32 per point", ANEW)
    if size % (4 * width):
        fitting = next((n for n in REMEDIES if size % (4 * n) == 0), None)
        raise FormatError(
            path,
            f"{size} bytes",
            expected,
            "it is cut off or of another kind" + (f"; {REMEDIES[fitting]}" if fitting else ""),
        )
    return values


def _evident_columns(values: Float, columns: int) -> int | None:
    """Return another number of columns that evidently fits better, None if there is none.

    Only coordinates are negative. A wrong number of columns puts coordinates into the
    intensity, so there are negative ones; the right number has none after the third column.
    """
    if not (values[3::columns] < 0).any():
        return None
    others = (n for n in REMEDIES if n != columns and values.size % n == 0)
    return next((n for n in others if not (values.reshape(-1, n)[:, 3:] < 0).any()), None)


def count_points(path: Path) -> int:
    """Return the number of points of a `.bin` file of four columns, from its size.

    Raises
    ------
    FormatError
        If the file cannot be read.
    """
    with reading(path) as file:
        return size_of(file) // (4 * COLUMNS)


def encode_bin(scan: Scan) -> bytes:
    """Return the content of a `.bin` file: float32 x, y, z, intensity of each point."""
    return np.column_stack([scan.points, scan.intensity]).astype("<f4", copy=False).tobytes()


def read_labels(path: Path, count: int | None = None) -> RawIds:
    """Read the raw ids of a scan's points, (N,) uint32.

    Parameters
    ----------
    path : Path
        The `.label` file.
    count : int, optional
        Number of points of the scan; then two bytes or one per label are recognised too.

    Raises
    ------
    FormatError
        If the file cannot be read or is cut off.
    LabelError
        If there are not `count` labels.
    """
    with reading(path) as file:
        size = size_of(file)
        if size % 4 and (count is None or size not in (count, 2 * count)):
            raise FormatError(
                path, f"{size} bytes", "a multiple of 4 (one uint32 per point)", "it is cut off"
            )
        raw = _labels(read_values(file, path, np.uint8, size), count or 0)
    if count is not None and len(raw) != count:
        raise LabelError(
            path,
            f"{len(raw)} labels",
            f"{count}, one per point of the scan",
            "use the labels that belong to this scan",
        )
    return raw


def _labels(content: npt.NDArray[np.uint8], count: int) -> RawIds:
    """Return labels of two bytes or one where so many are so long, else of four."""
    narrow = {2 * count: "<u2", count: "<u1"}.get(content.size)
    wide = content[: content.size // 4 * 4].view("<u4").astype(np.uint32, copy=False)
    # Classes of four bytes, without instances, of half or a quarter of the points.
    of_fewer = content.size % 4 == 0 and wide.any() and wide.max() <= MAX_CLASS
    if narrow is None or of_fewer:
        return wide
    return content.view(narrow).astype(np.uint32)


def encode_labels(raw: RawIds) -> bytes:
    """Return the content of a `.label` file: the raw id of each point as uint32."""
    return raw.astype("<u4", copy=False).tobytes()
