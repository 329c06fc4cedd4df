# SPDX-License-Identifier: MIT
"""PCD clouds: ascii, binary and binary_compressed.

open3d only unpacks compressed data, of a copy with a header in the usual form: it writes beyond its
memory where HEIGHT comes after POINTS and on padding fields (`_` with COUNT ≠ 1), and fills clouds
with uninitialised values where ascii files are short or DATA is in upper case.
"""

import io
import logging
import math
from io import BufferedIOBase, BufferedReader
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Any, NamedTuple

import numpy as np

from salsanext_cli.errors import notice_once
from salsanext_cli.files.optional_packages import import_open3d
from salsanext_cli.files.reading import read_values, reading, refusing_damage, size_of
from salsanext_cli.formats.columns import Columns
from salsanext_cli.records import Double

TYPES = {
    **{kind + size: f"<{kind.lower()}{size}" for kind in "IU" for size in "1248"},
    **{"F4": "<f4", "F8": "<f8", "D8": "<f8"},
}
"""numpy's type of each TYPE and SIZE."""
COMMAS = "commas in .pcd files are taken for blanks"
PADDING = "_"
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
        """Names of the fields with one named value per point; the others have a space."""
        return [name for name in self.point.names or () if " " not in name]

    def encode(self) -> bytes:
        """Return the header in its usual form and order, of scalars in one row."""
        kinds = [self.point[name].str for name in self.scalars]
        return (
            f"VERSION 0.7\nFIELDS {' '.join(self.scalars)}\n"
            f"SIZE {' '.join(kind[2] for kind in kinds)}\n"
            f"TYPE {' '.join(kind[1].upper() for kind in kinds)}\n"
            f"COUNT {' '.join('1' for _ in kinds)}\n"
            f"WIDTH {self.point_count}\nHEIGHT 1\nPOINTS {self.point_count}\nDATA {self.kind}\n"
        ).encode()


def pcd_columns(path: Path) -> Columns:
    """Read the fields of a PCD file with one value per point, and the rows of an organised one."""
    with reading(path) as file, refusing_damage(path, "a whole PCD file"):
        header = read_header(file)
        match header.kind:
            case "ascii":
                columns = _read_ascii(file, header)
            case "binary":
                columns = _read_binary(file, path, header)
            case "binary_compressed":
                columns = read_compressed(file, header)
            case _:
                raise ValueError(f"PCD data of kind {header.kind}, not ascii or binary")
    return columns


def _read_ascii(file: BufferedReader, header: Header) -> Columns:
    shapes = [header.point[name].shape for name in header.point.names or ()]
    first = np.cumsum([0, *map(math.prod, shapes)])
    values = _numbers(file.read(), int(first[-1]), header.point_count)
    column_of = dict(zip(header.point.names or (), first[:-1], strict=True))
    # A NaN in an integer field that is not used is no reason to fail.
    with np.errstate(invalid="ignore", over="ignore"):
        return {
            name: values[:, column_of[name]].astype(header.point[name]) for name in header.scalars
        }


def _numbers(text: bytes, width: int, count: int) -> Double:
    """Return the numbers of lines of so many, (N, width) float64; N is `count`, or else logged."""
    if b"," in text:
        text = text.replace(b",", b" ")
        notice_once(COMMAS)
    values = np.empty((0, width))
    if text.strip():
        try:
            values = np.loadtxt(io.BytesIO(text), np.float64, comments=None, ndmin=2)
        except ValueError:
            values = np.loadtxt(_filled(text, width), np.float64, comments=None, ndmin=2)
    is_whole = len(values) > 0 and text.endswith(b"\n")
    if values.shape[1] != width or (len(values) != count and not is_whole):
        raise ValueError(f"{len(values)} lines of {values.shape[1]} values, not {count} of {width}")
    if len(values) != count:
        found = "the header of a .pcd file gives another number of points than it has lines"
        notice_once(f"{found}: all lines are read; points may be missing", logging.WARNING)
    return values


def _filled(text: bytes, width: int) -> list[bytes]:
    """Return lines in which short ones, but not the last, which is cut off, are points of NaN."""
    *lines, last = (line for line in text.splitlines() if line.strip())
    filled = [line if len(line.split()) >= width else b"nan " * width for line in lines]
    if filled != lines:
        notice_once("short lines in .pcd files are taken for points without a measurement")
    return [*filled, last]


def _read_binary(file: BufferedReader, path: Path, header: Header) -> Columns:
    promised = header.point_count * header.point.itemsize
    if (held := size_of(file) - file.tell()) < promised:
        raise ValueError(f"{held} bytes of data, not {promised}")
    points = read_values(file, path, header.point, header.point_count)
    return {name: points[name] for name in header.scalars}


def read_compressed(file: BufferedIOBase, header: Header) -> Columns:
    """Unpack compressed columns with open3d, which leaves out or converts some."""
    if header.scalars != [*(header.point.names or ())]:
        raise ValueError("compressed PCD data with fields of several values")
    sizes = np.frombuffer(file.read(8), "<u4")
    promised = header.point_count * header.point.itemsize
    packed = file.read()
    if len(sizes) < 2 or len(packed) < sizes[0] or sizes[1] != promised:
        raise ValueError(f"{len(packed)} bytes of compressed data, not of {promised}")
    if promised > MAX_RATIO * sizes[0]:
        raise ValueError(f"{sizes[0]} bytes of compressed data that cannot be of {promised}")
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
        raise ValueError("compressed PCD data that does not unpack")
    columns = {name: cloud.point[name].numpy()[:, 0] for name in cloud.point}
    return columns | dict(zip("xyz", cloud.point.positions.numpy().T, strict=True))


def read_header(file: BufferedIOBase) -> Header:
    """Read up to the line DATA; an unusable header raises `ValueError`."""
    entries = _entries(file)
    if "D" in entries.get("TYPE", ()):
        notice_once("TYPE D in .pcd files is taken for F")
    try:
        names = entries["FIELDS"]
        counts = [*map(int, entries.get("COUNT", ["1"] * len(names)))]
        fields = zip(names, entries["TYPE"], entries["SIZE"], counts, strict=True)
        point = np.dtype(
            [
                (name, TYPES[kind + size])
                if count == 1 and name != PADDING
                else (f"{name} {place}", TYPES[kind + size], (count,))
                for place, (name, kind, size, count) in enumerate(fields)
            ]
        )
        points = entries.get("POINTS") or entries["WIDTH"] + entries["HEIGHT"]
        height = int(entries.get("HEIGHT", ["1"])[0])
        return Header(point, math.prod(map(int, points)), entries["DATA"][0].lower(), height)
    except (LookupError, ValueError) as error:
        raise ValueError(f"an unusable PCD header: {error}") from error


def _entries(file: BufferedIOBase) -> dict[str, list[str]]:
    """Return the words after each keyword."""
    entries: dict[str, list[str]] = {}
    while "DATA" not in entries:
        line = file.readline(MAX_HEADER_BYTES)
        if not line or file.tell() > MAX_HEADER_BYTES:
            raise ValueError("no PCD header")
        words = line.decode("ascii", "replace").replace(",", " ").split()
        if words and not words[0].startswith("#"):
            if b"," in line:
                notice_once(COMMAS)
            entries[words[0]] = words[1:]
    return entries
