# SPDX-License-Identifier: MIT
"""PCD clouds: ascii, binary and binary_compressed.

open3d only unpacks compressed data, of a copy with a header in the usual form: it writes beyond its
memory where HEIGHT comes after POINTS and on padding fields (`_` with COUNT ≠ 1), and fills clouds
with uninitialised values where ascii files are short or DATA is in upper case.
"""

import io
import math
from dataclasses import dataclass
from io import BufferedReader
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Any

import numpy as np

from salsanext_cli.files.optional_packages import import_open3d
from salsanext_cli.files.reading import read_values, reading, refusing_damage, size_of
from salsanext_cli.formats.columns import Columns, rows_as_rings, scan_of
from salsanext_cli.records import Scan

TYPES = {
    **{f"F{size}": f"<f{size}" for size in (4, 8)},
    **{f"I{size}": f"<i{size}" for size in (1, 2, 4, 8)},
    **{f"U{size}": f"<u{size}" for size in (1, 2, 4, 8)},
}
"""numpy's type of each TYPE and SIZE."""
CODES = {kind: code for code, kind in TYPES.items()}
PADDING = "_"
MAX_DIGITS = 15
MAX_HEADER_BYTES = 1 << 16
"""Size of the largest header and of the largest row."""
LARGEST_RATIO = 264 / 3
"""Largest compression ratio of LZF: three bytes stand for up to 264."""


@dataclass(frozen=True, slots=True)
class Header:
    """Fields, points and encoding of a PCD file."""

    names: tuple[str, ...]  # Fields in order of storage: name, numpy type, values per point
    types: tuple[str, ...]
    counts: tuple[int, ...]
    points: int  # N
    kind: str  # Encoding of the points
    height: int = 1  # Rows of an organised cloud, else 1

    def __post_init__(self) -> None:
        named = [name for name in self.names if name != PADDING]
        if len(set(named)) < len(named):
            raise ValueError("a field twice")
        if self.points < 0 or min(self.counts, default=0) < 0:
            raise ValueError("a negative number")
        if self.row_bytes > MAX_HEADER_BYTES:
            raise ValueError(f"{self.row_bytes} bytes per point")

    @property
    def scalars(self) -> dict[str, int]:
        """Names and indices of the fields with one named value per point."""
        return {n: i for i, n in enumerate(self.names) if n != PADDING and self.counts[i] == 1}

    @property
    def row_bytes(self) -> int:
        """Size of one point, padding included."""
        sizes = (np.dtype(kind).itemsize for kind in self.types)
        return sum(size * count for size, count in zip(sizes, self.counts, strict=True))

    @property
    def row(self) -> np.dtype[Any]:
        """Type of a point in plain binary data."""
        scalars = self.scalars
        # A name in a header never has a space.
        names = (n if n in scalars else f"field {i}" for i, n in enumerate(self.names))
        shapes = (() if count == 1 else (count,) for count in self.counts)
        return np.dtype(list(zip(names, self.types, shapes, strict=True)))

    def encode(self) -> bytes:
        """Return the header in its usual form and order, of a cloud in one row."""
        types = [CODES[kind] for kind in self.types]
        return (
            f"VERSION 0.7\nFIELDS {' '.join(self.names)}\nSIZE {' '.join(t[1:] for t in types)}\n"
            f"TYPE {' '.join(t[0] for t in types)}\nCOUNT {' '.join(map(str, self.counts))}\n"
            f"WIDTH {self.points}\nHEIGHT 1\nPOINTS {self.points}\nDATA {self.kind}\n"
        ).encode()


def read_pcd(path: Path, *, intensity_scale: float = 1.0) -> Scan:
    """Read a PCD file; intensities of one byte are divided by 255, without any they are 0."""
    header, columns = _read(path)
    # Without columns, points take no room, however many there are.
    rings = rows_as_rings(header.points, header.height) if columns else {}
    return scan_of({**rings, **columns}, path, intensity_scale)


def pcd_columns(path: Path) -> Columns:
    """Read the fields of a PCD file with one value per point."""
    return _read(path)[1]


def _read(path: Path) -> tuple[Header, Columns]:
    with reading(path) as file, refusing_damage(path, "a whole PCD file"):
        header = _read_header(file)
        match header.kind:
            case "ascii":
                return header, _read_ascii(file, header)
            case "binary":
                return header, _read_binary(file, path, header)
            case "binary_compressed":
                return header, _read_compressed(file, header)
        raise ValueError(f"PCD data of kind {header.kind}, not ascii or binary")


def _read_ascii(file: BufferedReader, header: Header) -> Columns:
    text, width = file.read(), sum(header.counts)
    values = np.empty((0, width))
    if text.strip():
        values = np.loadtxt(io.BytesIO(text), np.float64, comments=None, ndmin=2)
    if values.shape != (header.points, width):
        found = f"{len(values)} lines of {values.shape[1]} values"
        raise ValueError(f"{found}, not {header.points} of {width}")
    first = np.cumsum((0, *header.counts))
    # A NaN in an integer field that is not used is no reason to fail.
    with np.errstate(invalid="ignore", over="ignore"):
        return {
            name: values[:, first[i]].astype(header.types[i]) for name, i in header.scalars.items()
        }


def _read_binary(file: BufferedReader, path: Path, header: Header) -> Columns:
    promised = header.points * header.row_bytes
    if (held := size_of(file) - file.tell()) < promised:
        raise ValueError(f"{held} bytes of data, not {promised}")
    table = read_values(file, path, header.row, header.points)
    return {name: table[name] for name in header.scalars}


def _read_compressed(file: BufferedReader, header: Header) -> Columns:
    if len(header.scalars) < len(header.names):
        raise ValueError("compressed PCD data with fields of several values")
    sizes = np.frombuffer(file.read(8), "<u4")
    promised = header.points * header.row_bytes
    packed = file.read()
    if len(sizes) < 2 or len(packed) < sizes[0] or sizes[1] != promised:
        raise ValueError(f"{len(packed)} bytes of compressed data, not of {promised}")
    if promised > LARGEST_RATIO * sizes[0]:
        raise ValueError(f"{sizes[0]} bytes of compressed data that cannot be of {promised}")
    if header.points == 0:
        return {name: np.empty(0, t) for name, t in zip(header.names, header.types, strict=True)}
    open3d = import_open3d()
    with (
        NamedTemporaryFile(suffix=".pcd") as copy,
        open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error),
    ):
        copy.write(header.encode() + sizes.tobytes() + packed[: sizes[0]])
        copy.flush()
        cloud = open3d.t.io.read_point_cloud(copy.name, format="pcd")
    if "positions" not in cloud.point or len(cloud.point.positions) != header.points:
        raise ValueError("compressed PCD data that does not unpack")
    columns = {name: cloud.point[name].numpy()[:, 0] for name in cloud.point}
    return columns | dict(zip("xyz", cloud.point.positions.numpy().T, strict=True))


def _read_header(file: BufferedReader) -> Header:
    """Read up to the line DATA; an unusable header raises `ValueError`."""
    entries = _entries(file)
    try:
        names = tuple(entries["FIELDS"])
        counts = entries.get("COUNT", ["1"] * len(names))
        points = entries.get("POINTS") or entries["WIDTH"] + entries["HEIGHT"]
        fields = [*zip(entries["TYPE"], entries["SIZE"], counts, names, strict=True)]
        return Header(
            names,
            tuple(TYPES[kind + size] for kind, size, _, _ in fields),
            tuple(map(_number, counts)),
            math.prod(map(_number, points)),
            entries["DATA"][0].lower(),
            _number(entries.get("HEIGHT", ["1"])[0]),
        )
    except (LookupError, ValueError) as error:
        raise ValueError(f"an unusable PCD header: {error}") from error


def _entries(file: BufferedReader) -> dict[str, list[str]]:
    """Return the words after each keyword."""
    entries: dict[str, list[str]] = {}
    while "DATA" not in entries:
        line = file.readline(MAX_HEADER_BYTES)
        if not line or file.tell() > MAX_HEADER_BYTES:
            raise ValueError("no PCD header")
        words = line.decode("ascii", "replace").split()
        if words and not words[0].startswith("#"):
            entries[words[0]] = words[1:]
    return entries


def _number(word: str) -> int:
    """Return a number of fields or points, of a size that can be calculated with."""
    if len(word) > MAX_DIGITS:
        raise ValueError("an impossible number")
    return int(word)
