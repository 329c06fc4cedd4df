# SPDX-License-Identifier: MIT
"""Headerless little-endian files of KITTI and nuScenes: scans, `.bin`, and labels, `.label`.

Files of anything but points are refused.
"""

import re
from dataclasses import dataclass
from io import BufferedReader
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.classes.label_space import RawIds
from salsanext_cli.core.errors import FormatError, LabelError, counted, notice_once
from salsanext_cli.core.records import Float, Scan, normalised_intensity
from salsanext_cli.core.sensors.sensor import UNUSED_COLUMN
from salsanext_cli.core.wording import argument, setting
from salsanext_cli.io.files.atomic import write_bytes
from salsanext_cli.io.files.reading import read_values, reading, size_of
from salsanext_cli.io.formats import FORMATS
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
MAX_CLASS = 0xFFFF  # Largest label of four bytes without an instance


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
    """Read a scan of x, y, z, intensity and, in `.pcd.bin` files, ring, or of `columns`."""
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
    width = len(columns) or usual_width(path)
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
    if count := evident_count(rounded, width):
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


def usual_width(path: Path) -> int:
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
    if kind := other_kind(file.read(TEXT_BYTES)):
        is_suffix = kind.startswith(".")
        hint = f"rename it to {kind} if it contains points" if is_suffix else REWRITE
        name = "text" if kind == TEXT_SUFFIX else f"a {kind} file" if is_suffix else kind
        raise FormatError(path, f"is {name}", f"{width} float32 per point", hint)
    return size


def _multiple_of(width: int, itemsize: int = 4) -> str:
    kind = f"float{8 * itemsize}"
    return f"a multiple of {itemsize * width}: {width} {kind} per point"


def _no_coordinates(path: Path, width: int) -> FormatError:
    problem = "contains numbers that are not float32, or not coordinates in metres"
    return FormatError(path, problem, f"{width} float32 per point", REWRITE)


def _other_count(path: Path, count: int, expected: int) -> FormatError:
    """Return the error of a file with another number of columns, with names to try."""
    hint = f"name its columns, for example with {setting('columns', names_to_try(count))}"
    if count == usual_width(path):
        hint = f"omit {argument('columns')}"
    elif suffix := {COLUMNS: ".bin", COLUMNS_WITH_RING: ".pcd.bin"}.get(count):
        hint = f"rename it to {suffix}, or {hint}"
    return FormatError(path, f"has {count} columns", f"{expected} per point", hint)


def count_points(path: Path) -> int:
    """Return the number of points of a `.bin` file of the usual columns, float32 or float64.

    Only a sample of the values is read: their type and the size of the file determine the number.
    """
    width = usual_width(path)
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


def read_labels(path: Path, count: int | None = None) -> RawIds:
    """Read the raw ids of the points of a scan.

    Parameters
    ----------
    path : Path
        The `.label` file.
    count : int, optional
        Number of points of the scan; then labels of one or two bytes are recognised too.

    Returns
    -------
    (N,) uint32
        Class in the low 16 bits, instance in the high 16.

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
            expected = "a multiple of 4: one uint32 per point"
            raise FormatError(path, f"has {size} bytes", expected, "copy it again")
        raw = _labels(read_values(file, path, np.uint8, size), count or 0)
    if count is not None and len(raw) != count:
        expected = f"{count:,}, one per point of the scan"
        hint = "use the labels that belong to this scan"
        raise LabelError(path, f"has {counted(len(raw), 'label')}", expected, hint)
    return raw


def _labels(content: npt.NDArray[np.uint8], count: int) -> RawIds:
    """Return labels of two bytes or one if the size is that of `count`, else of four."""
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


def write_labels(path: Path, raw: RawIds) -> None:
    """Write the raw ids of the points of a scan.

    Parameters
    ----------
    path : Path
        The `.label` file.
    raw : (N,) integers
        Raw ids, written as uint32.
    """
    write_bytes(path, encode_labels(raw))


MAGIC = {
    **{magic: form.suffixes[0] for form in FORMATS.values() for magic in form.magic},
    b"\x1f\x8b": "a gzip file",
    b"#ROSBAG": ".bag",
    b"\x89MCAP0": ".mcap",
    b"ASTM-E57": "an E57 file",
    b"LASF": "a LAS file",
    b"\x00\x01\x00\x00": "a message of ROS 2",  # in CDR, little endian
}
"""Suffixes or names of other formats by their first bytes."""
TEXT_SUFFIX = ".csv"
TERRASCAN = b"\xa1\xce\x0e\x00CXYZ"  # Bytes 8 to 16 of files of TerraScan
TEXT_BYTES = 4096  # Size of the start of a file that shows whether it is text
MIN_TEXT_BYTES = 256  # Size from which float32 values contain bytes that do not occur in text
MIN_ASCII_BYTES = 16  # The same for ASCII, which is hardly ever coordinates in metres
CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1a\x1c-\x1f\x7f]")  # Bytes that do not occur in text


def other_kind(start: bytes) -> str | None:
    """Return suffix or name of another format, or of text, by the first bytes; None without one."""
    of_magic = (kind for magic, kind in MAGIC.items() if start.startswith(magic))
    least = MIN_ASCII_BYTES if start.isascii() else MIN_TEXT_BYTES
    is_text = len(start) >= least and not CONTROL.search(start)
    other = TEXT_SUFFIX if is_text else "a TerraScan file" if start[8:16] == TERRASCAN else None
    return next(of_magic, other)
