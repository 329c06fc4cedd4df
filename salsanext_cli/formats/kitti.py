# SPDX-License-Identifier: MIT
"""KITTI's raw files: `.bin` scans and `.label` labels, little endian, no header."""

from pathlib import Path

import numpy as np

from salsanext_cli.classes import RawIds
from salsanext_cli.errors import FormatError, LabelError
from salsanext_cli.formats.columns import normalised_intensity
from salsanext_cli.formats.reading import read_values, reading, size_of
from salsanext_cli.records import Float, Scan

COLUMNS = 4
"""x, y, z in metres, remission."""
COLUMNS_WITH_RING = 5
"""x, y, z, intensity, ring: the `.pcd.bin` files of nuScenes."""
REMEDIES = {
    COLUMNS: "give a file of 4 columns the suffix .bin",
    COLUMNS_WITH_RING: "give a file of 5 columns the suffix .pcd.bin",
    6: "write it anew with the columns x, y, z, intensity",
}
"""Advice for a file with that number of columns where another is expected."""


def read_bin(path: Path, *, intensity_scale: float = 1.0) -> Scan:
    """Read a scan of float32 x, y, z, intensity and, in `.pcd.bin` files, ring.

    Parameters
    ----------
    path : Path
        The file; 0 bytes are a scan of 0 points.
    intensity_scale : float
        Divides the intensity.

    Raises
    ------
    FormatError
        If the file cannot be read, is truncated, or evidently has another number of columns.
    """
    has_ring = path.name.lower().endswith(".pcd.bin")
    columns = COLUMNS_WITH_RING if has_ring else COLUMNS
    with reading(path) as file:
        size = size_of(file)
        if size % (4 * columns):
            fitting = next((n for n in REMEDIES if size % (4 * n) == 0), None)
            raise FormatError(
                path,
                f"{size} bytes",
                f"a multiple of {4 * columns} ({columns} float32 per point)",
                "it is cut off or of another kind" + (f"; {REMEDIES[fitting]}" if fitting else ""),
            )
        values = read_values(file, path, "<f4", size // 4)
    if fitting := _evident_columns(values, columns):
        raise FormatError(
            path, f"holds {fitting} columns", f"{columns} float32 per point", REMEDIES[fitting]
        )
    table = values.reshape(-1, columns)
    return Scan(
        np.ascontiguousarray(table[:, :3], np.float32),
        normalised_intensity(table[:, 3], intensity_scale),
    )


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
        Number of points of the scan.

    Raises
    ------
    FormatError
        If the file cannot be read or is cut off.
    LabelError
        If there are not `count` labels.
    """
    with reading(path) as file:
        size = size_of(file)
        if size % 4:
            raise FormatError(
                path, f"{size} bytes", "a multiple of 4 (one uint32 per point)", "it is cut off"
            )
        raw: RawIds = read_values(file, path, "<u4", size // 4).astype(np.uint32, copy=False)
    if count is not None and len(raw) != count:
        raise LabelError(
            path,
            f"{len(raw)} labels",
            f"{count}, one per point of the scan",
            "use the labels that belong to this scan",
        )
    return raw


def encode_labels(raw: RawIds) -> bytes:
    """Return the content of a `.label` file: the raw id of each point as uint32."""
    return raw.astype("<u4", copy=False).tobytes()
