# SPDX-License-Identifier: MIT
"""PCD clouds: ascii, binary and binary_compressed.

open3d only unpacks compressed data, from a copy with a regular header. On other headers it writes
beyond its memory or returns uninitialised values.
"""

import io
import logging
import math
from dataclasses import dataclass
from io import BufferedIOBase, BufferedReader
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Any

import numpy as np

from salsanext_cli.core.errors import FormatError
from salsanext_cli.core.notices import notice_once, warn_once
from salsanext_cli.core.optional_packages import import_open3d
from salsanext_cli.core.records import Double, Scan
from salsanext_cli.core.texts import error_text, shortened
from salsanext_cli.io.files.reading import read_values, reading, refusing_damage, size_of
from salsanext_cli.io.formats.columns import Columns, scan_of
from salsanext_cli.io.formats.tables.text import require_decimal_points
from salsanext_cli.io.formats.tables.text_layout import is_number

log = logging.getLogger(__name__)

TYPES = {
    **{kind + size: f"<{kind.lower()}{size}" for kind in "IU" for size in "1248"},
    **{"F4": "<f4", "F8": "<f8", "D8": "<f8"},
}
"""NumPy's type by TYPE and SIZE."""
COMMAS = "commas in .pcd files are read as blanks"
MAX_SHORT_SHARE = 0.01  # Largest share of lines that lack values
MAX_HEADER_BYTES = 1 << 16
MAX_RATIO = 264 / 3  # Largest compression ratio of LZF: three bytes stand for up to 264


@dataclass(frozen=True, slots=True, kw_only=True)
class Header:
    """Fields, points and encoding of a PCD file."""

    point_type: np.dtype[Any]  # Fields of a point in order of storage, as `_field_type` names them
    point_count: int  # N
    encoding: str  # Of the points: ascii, binary, binary_compressed, or an unknown word
    height: int  # Rows of an organised cloud, else 1

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all fields."""
        return self.point_type.names or ()

    @property
    def scalars(self) -> list[str]:
        """Names of the fields with one value per point; the names of the others have a space."""
        return [name for name in self.names if " " not in name]

    def encode(self) -> bytes:
        """Return a regular header of the scalars, in one row."""
        types = [self.point_type[name].str for name in self.scalars]
        return (
            f"VERSION 0.7\nFIELDS {' '.join(self.scalars)}\n"
            f"SIZE {' '.join(kind[2] for kind in types)}\n"
            f"TYPE {' '.join(kind[1].upper() for kind in types)}\n"
            f"WIDTH {self.point_count}\nHEIGHT 1\nPOINTS {self.point_count}\nDATA {self.encoding}\n"
        ).encode()


@dataclass(frozen=True, slots=True, kw_only=True)
class _Content:
    """Fields of a PCD file with one value per point."""

    columns: Columns
    missing_points: int = 0  # Points that the header states, but that the file lacks


def read_pcd(
    path: Path, _: tuple[str, ...], intensity_scale: float, intensity_field: str = ""
) -> Scan:
    """Read the scan of a PCD file, row by row if it is organised."""
    content = _read(path)
    return scan_of(
        content.columns,
        path,
        intensity_scale,
        intensity_field,
        missing_points=content.missing_points,
    )


def pcd_columns(path: Path) -> Columns:
    """Read the fields of a PCD file with one value per point, row by row if it is organised."""
    content = _read(path)
    if content.missing_points:
        missing = f"{content.missing_points:,} of the points that its header states"
        warn_once(log, f"{path}: lacks {missing}")
    return content.columns


def _read(path: Path) -> _Content:
    with reading(path) as file, refusing_damage(path, "a complete .pcd file"):
        header = read_header(file, path)
        match header.encoding:
            case "ascii":
                columns = _read_ascii(file, path, header)
                count = len(next(iter(columns.values()), ()))
                missing = max(header.point_count - count, 0)
                return _Content(columns=columns, missing_points=missing)
            case "binary":
                return _Content(columns=_read_binary(file, path, header))
            case "binary_compressed":
                return _Content(columns=read_compressed(file, header))
        expected = "ascii, binary or binary_compressed"
        raise FormatError(path, f"has DATA {shortened(header.encoding)}", expected)


def _read_ascii(file: BufferedReader, path: Path, header: Header) -> Columns:
    column_of: dict[str, int] = {}
    width = 0
    for name in header.names:
        column_of[name] = width
        width += math.prod(header.point_type[name].shape)
    start = file.tell()
    file.seek(0)
    first_line = file.read(start).count(b"\n") + 1
    values = _numbers(file.read(), width, header.point_count, path, first_line)
    with np.errstate(invalid="ignore", over="ignore"):  # of a NaN in an unused integer field
        return {
            name: values[:, column_of[name]].astype(header.point_type[name])
            for name in header.scalars
        }


def _numbers(text: bytes, width: int, count: int, path: Path, first_line: int) -> Double:
    """Return the numbers of the lines after the header.

    Parameters
    ----------
    text : bytes
        The lines.
    width : int
        Number of values of a point.
    count : int
        Number of points that the header states.
    path : Path
        The file, for messages.
    first_line : int
        Number of the first line in the file, from 1.

    Returns
    -------
    (N, width) float64
        N may be smaller if the text ends with a whole line, and larger than `count`.
    """
    plain = text.replace(b",", b" ")
    values = np.empty((0, width))
    if plain.strip():
        try:
            values = np.loadtxt(io.BytesIO(plain), np.float64, comments=None, ndmin=2)
        except ValueError:
            values = np.empty((0, 0))
        if values.shape[1] != width:
            values = _irregular(text, width, count, path, first_line)
    ends_with_point = len(values) > 0 and text.endswith(b"\n")
    if len(values) < count and not ends_with_point:
        raise ValueError(f"{len(values)} of {count} points")
    if len(values) > count:
        problem = f"has {len(values)} lines of points, but its header states {count}"
        warn_once(log, f"{path}: {problem}")
    if plain != text:
        notice_once(COMMAS)
    return values


def _irregular(text: bytes, width: int, count: int, path: Path, first_line: int) -> Double:
    """Return the numbers as `_numbers` does; a few lines lack the last ones, which become NaN."""
    rows: list[list[float]] = []
    short_lines: list[str] = []
    is_last_short = False
    for number, line in enumerate(text.splitlines(), first_line):
        words = _words_of_point(line, number, width, path)
        if not words:
            is_last_short = False
            continue
        missing = width - len(words)
        rows.append([float(word) for word in words] + [math.nan] * missing)
        is_last_short = missing > 0
        if is_last_short:
            short_lines.append(_wrong_width(number, words, width))
    if is_last_short:
        raise ValueError(f"{len(rows) - 1} of {count} points; {short_lines[-1]}")
    if len(short_lines) > MAX_SHORT_SHARE * len(rows):
        problem = f"{len(short_lines)} of {len(rows)} lines are too short"
        raise ValueError(f"{problem}; {short_lines[0]}")
    for short_line in short_lines:
        notice_once(f"{path}: {short_line}; the others are read as NaN")
    return np.array(rows)


def _words_of_point(line: bytes, number: int, width: int, path: Path) -> list[str]:
    """Return the numbers of a line as text, none of an empty line; refuse other words."""
    words = line.replace(b",", b" ").decode("latin-1").split()
    if len(words) == 2 * width:
        # Each number with a decimal comma has become two.
        require_decimal_points(line, path)
    wrong = [word for word in words if not is_number(word)]
    if wrong:
        raise ValueError(f"line {number} has {shortened(wrong[0])!r} instead of a number")
    if len(words) > width:
        raise ValueError(_wrong_width(number, words, width))
    return words


def _wrong_width(number: int, words: list[str], width: int) -> str:
    """Return the text about a line with another number of values than the header states."""
    return f"line {number} has {len(words)} of {width} values"


def _read_binary(file: BufferedReader, path: Path, header: Header) -> Columns:
    stated = header.point_count * header.point_type.itemsize
    actual = size_of(file) - file.tell()
    if actual < stated:
        raise ValueError(f"{actual} bytes of data, not {stated}")
    points = read_values(file, path, header.point_type, header.point_count)
    return {name: points[name] for name in header.scalars}


def read_compressed(file: BufferedIOBase, header: Header) -> Columns:
    """Unpack compressed columns with open3d, which omits or converts some."""
    if header.scalars != list(header.names):
        raise ValueError("compressed PCD data with fields of several values")
    sizes = np.frombuffer(file.read(8), "<u4")
    stated = header.point_count * header.point_type.itemsize
    packed = file.read()
    is_cut = len(sizes) < 2 or len(packed) < sizes[0] or sizes[1] != stated
    if is_cut or stated > MAX_RATIO * sizes[0]:
        raise ValueError(f"{len(packed)} bytes of compressed data cannot contain {stated}")
    if header.point_count == 0:
        return {name: np.empty(0, header.point_type[name]) for name in header.scalars}
    open3d = import_open3d()
    with (
        NamedTemporaryFile(suffix=".pcd") as copy,
        open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error),
    ):
        copy.write(header.encode() + sizes.tobytes() + packed[: sizes[0]])
        copy.flush()
        cloud = open3d.t.io.read_point_cloud(copy.name, format="pcd")
    if "positions" not in cloud.point or len(cloud.point.positions) != header.point_count:
        raise ValueError("compressed data that cannot be unpacked")
    columns = {name: cloud.point[name].numpy()[:, 0] for name in cloud.point}
    return columns | dict(zip("xyz", cloud.point.positions.numpy().T, strict=True))


def read_header(file: BufferedIOBase, path: Path) -> Header:
    """Read up to the line DATA; refuse an unusable header."""
    entries = _entries(file, path)
    kinds = [kind.upper() for kind in entries.get("TYPE", ())]
    if "D" in kinds:
        notice_once("TYPE D in .pcd files is read as F")
    lacking = [key for key in ("FIELDS", "SIZE", "TYPE", "DATA") if not entries.get(key)]
    if lacking:
        raise _unusable(path, f"no line {', '.join(lacking)}")
    names = entries["FIELDS"]
    sizes = entries["SIZE"]
    counts = entries.get("COUNT", ["1"] * len(names))
    if not len(names) == len(kinds) == len(sizes) == len(counts):
        numbers = f"{len(names)} FIELDS, {len(sizes)} SIZE, {len(kinds)} TYPE, {len(counts)} COUNT"
        raise _unusable(path, numbers)
    types = [kind + size for kind, size in zip(kinds, sizes, strict=True)]
    for kind, size in zip(kinds, sizes, strict=True):
        if kind + size not in TYPES:
            raise _unusable(path, f"TYPE and SIZE {shortened(f'{kind} {size}')}")
    try:
        fields = [
            _field_type(name, TYPES[kind], int(count), place)
            for place, (name, kind, count) in enumerate(zip(names, types, counts, strict=True))
        ]
        factors = entries.get("POINTS") or entries["WIDTH"] + entries["HEIGHT"]
        return Header(
            point_type=np.dtype(fields),
            point_count=math.prod(map(int, factors)),
            encoding=entries["DATA"][0].lower(),
            height=int(entries.get("HEIGHT", ["1"])[0]),
        )
    except (LookupError, ValueError) as error:
        raise _unusable(path, error_text(error)) from error


def _field_type(name: str, kind: str, count: int, place: int) -> tuple[Any, ...]:
    """Return a field of the type of a point, as `numpy.dtype` takes it.

    A field of several values, or of padding, whose name `_` may occur often, gets its place among
    the fields after its name and a space.
    """
    if count == 1 and name != "_":
        return name, kind
    return f"{name} {place}", kind, (count,)


def _unusable(path: Path, problem: str) -> FormatError:
    return FormatError(path, f"has an unusable header: {problem}", "the header of a PCD file")


def _entries(file: BufferedIOBase, path: Path) -> dict[str, list[str]]:
    """Return the words after each keyword."""
    entries: dict[str, list[str]] = {}
    while "DATA" not in entries:
        line = file.readline(MAX_HEADER_BYTES)
        if not line or file.tell() > MAX_HEADER_BYTES:
            raise FormatError(path, "has no PCD header", "a line DATA after the fields")
        words = line.decode("ascii", "replace").replace(",", " ").split()
        if words and not words[0].startswith("#"):
            if b"," in line:
                notice_once(COMMAS)
            entries[words[0].upper()] = words[1:]
    return entries
