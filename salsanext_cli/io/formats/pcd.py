# SPDX-License-Identifier: MIT
"""PCD clouds: ascii, binary and binary_compressed.

open3d only unpacks compressed data, from a copy with a regular header. On other headers it writes
beyond its memory or returns uninitialised values.
"""

import io
import logging
import math
from io import BufferedIOBase, BufferedReader
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Any, NamedTuple

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


class Header(NamedTuple):
    """Fields, points and encoding of a PCD file."""

    point: np.dtype[Any]  # Fields in order of storage
    point_count: int  # N
    kind: str  # Encoding of the points
    height: int  # Rows of an organised cloud, else 1

    @property
    def scalars(self) -> list[str]:
        """Names of the fields with one value per point; the others have a space."""
        return [name for name in self.point.names or () if " " not in name]

    def encode(self) -> bytes:
        """Return a regular header of the scalars, in one row."""
        kinds = [self.point[name].str for name in self.scalars]
        return (
            f"VERSION 0.7\nFIELDS {' '.join(self.scalars)}\n"
            f"SIZE {' '.join(kind[2] for kind in kinds)}\n"
            f"TYPE {' '.join(kind[1].upper() for kind in kinds)}\n"
            f"WIDTH {self.point_count}\nHEIGHT 1\nPOINTS {self.point_count}\nDATA {self.kind}\n"
        ).encode()


def read_pcd(
    path: Path, _: tuple[str, ...], intensity_scale: float, intensity_field: str = ""
) -> Scan:
    """Read the scan of a PCD file, row by row if it is organised."""
    columns, missing = _read(path)
    return scan_of(columns, path, intensity_scale, intensity_field, missing_points=missing)


def pcd_columns(path: Path) -> Columns:
    """Read the fields of a PCD file with one value per point, row by row if it is organised."""
    columns, missing = _read(path)
    if missing:
        warn_once(log, f"{path}: lacks {missing:,} of the points that its header states")
    return columns


def _read(path: Path) -> tuple[Columns, int]:
    """Return the fields of a PCD file, and the number of points that it lacks."""
    with reading(path) as file, refusing_damage(path, "a complete .pcd file"):
        header = read_header(file, path)
        match header.kind:
            case "ascii":
                columns = _read_ascii(file, path, header)
                count = len(next(iter(columns.values()), ()))
                return columns, max(header.point_count - count, 0)
            case "binary":
                return _read_binary(file, path, header), 0
            case "binary_compressed":
                return read_compressed(file, header), 0
        expected = "ascii, binary or binary_compressed"
        raise FormatError(path, f"has DATA {shortened(header.kind)}", expected)


def _read_ascii(file: BufferedReader, path: Path, header: Header) -> Columns:
    shapes = [header.point[name].shape for name in header.point.names or ()]
    first = np.cumsum([0, *map(math.prod, shapes)])
    start = file.tell()
    file.seek(0)
    line = file.read(start).count(b"\n") + 1
    values = _numbers(file.read(), int(first[-1]), header.point_count, path, line)
    column_of = dict(zip(header.point.names or (), first[:-1], strict=True))
    with np.errstate(invalid="ignore", over="ignore"):  # of a NaN in an unused integer field
        return {
            name: values[:, column_of[name]].astype(header.point[name]) for name in header.scalars
        }


def _numbers(text: bytes, width: int, count: int, path: Path, first: int) -> Double:
    """Return the numbers from line `first` on, (N, width) float64; N may differ from `count`."""
    plain = text.replace(b",", b" ")
    values = np.empty((0, width))
    if plain.strip():
        try:
            values = np.loadtxt(io.BytesIO(plain), np.float64, comments=None, ndmin=2)
        except ValueError:
            values = np.empty((0, 0))
        if values.shape[1] != width:
            values = _irregular(text, width, count, path, first)
    if len(values) < count and not (len(values) and text.endswith(b"\n")):
        raise ValueError(f"{len(values)} of {count} points")
    if len(values) > count:
        problem = f"has {len(values)} lines of points, but its header states {count}"
        warn_once(log, f"{path}: {problem}")
    if plain != text:
        notice_once(COMMAS)
    return values


def _irregular(text: bytes, width: int, count: int, path: Path, first: int) -> Double:
    """Return the numbers of lines, a few of which lack the last ones; these are NaN."""
    rows: list[list[float]] = []
    faults: list[str] = []
    is_last_short = False
    for number, line in enumerate(text.splitlines(), first):
        words = _words_of_point(line, number, width, path)
        if not words:
            is_last_short = False
            continue
        missing = width - len(words)
        rows.append([float(word) for word in words] + [math.nan] * missing)
        is_last_short = missing > 0
        if is_last_short:
            faults.append(_fault(number, words, width))
    if is_last_short:
        raise ValueError(f"{len(rows) - 1} of {count} points; {faults[-1]}")
    if len(faults) > MAX_SHORT_SHARE * len(rows):
        raise ValueError(f"{len(faults)} of {len(rows)} lines are too short; {faults[0]}")
    for fault in faults:
        notice_once(f"{path}: {fault}; the others are read as NaN")
    return np.array(rows)


def _words_of_point(line: bytes, number: int, width: int, path: Path) -> list[str]:
    """Return the numbers of a line as text, none of an empty line; refuse other words."""
    words = line.replace(b",", b" ").decode("latin-1").split()
    if len(words) == 2 * width:
        require_decimal_points(line, path)
    wrong = [word for word in words if not is_number(word)]
    if wrong:
        raise ValueError(f"line {number} has {shortened(wrong[0])!r} instead of a number")
    if len(words) > width:
        raise ValueError(_fault(number, words, width))
    return words


def _fault(number: int, words: list[str], width: int) -> str:
    return f"line {number} has {len(words)} of {width} values"


def _read_binary(file: BufferedReader, path: Path, header: Header) -> Columns:
    stated = header.point_count * header.point.itemsize
    actual = size_of(file) - file.tell()
    if actual < stated:
        raise ValueError(f"{actual} bytes of data, not {stated}")
    points = read_values(file, path, header.point, header.point_count)
    return {name: points[name] for name in header.scalars}


def read_compressed(file: BufferedIOBase, header: Header) -> Columns:
    """Unpack compressed columns with open3d, which omits or converts some."""
    if header.scalars != list(header.point.names or ()):
        raise ValueError("compressed PCD data with fields of several values")
    sizes = np.frombuffer(file.read(8), "<u4")
    stated = header.point_count * header.point.itemsize
    packed = file.read()
    is_cut = len(sizes) < 2 or len(packed) < sizes[0] or sizes[1] != stated
    if is_cut or stated > MAX_RATIO * sizes[0]:
        raise ValueError(f"{len(packed)} bytes of compressed data cannot contain {stated}")
    if header.point_count == 0:
        return {name: np.empty(0, header.point[name]) for name in header.scalars}
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
    fields = list(zip(names, kinds, sizes, counts, strict=True))
    unknown = [f"{kind} {size}" for _, kind, size, _ in fields if kind + size not in TYPES]
    if unknown:
        raise _unusable(path, f"TYPE and SIZE {shortened(unknown[0])}")
    try:
        point = np.dtype(
            [
                (name, TYPES[kind + size])
                if int(count) == 1 and name != "_"  # padding
                else (f"{name} {place}", TYPES[kind + size], (int(count),))
                for place, (name, kind, size, count) in enumerate(fields)
            ]
        )
        points = entries.get("POINTS") or entries["WIDTH"] + entries["HEIGHT"]
        height = int(entries.get("HEIGHT", ["1"])[0])
        return Header(point, math.prod(map(int, points)), entries["DATA"][0].lower(), height)
    except (LookupError, ValueError) as error:
        raise _unusable(path, error_text(error)) from error


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
