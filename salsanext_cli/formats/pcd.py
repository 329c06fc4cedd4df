# SPDX-License-Identifier: MIT
"""PCD clouds: ascii, binary and binary_compressed.

open3d only unpacks compressed files, and only after their header was checked here: it corrupts
memory on padding fields (`_` with COUNT ≠ 1) and fills short ascii files with uninitialised values.
"""

from __future__ import annotations

import io
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from salsanext_cli.errors import FormatError, MissingDependency
from salsanext_cli.formats.columns import Columns, scan_of
from salsanext_cli.formats.reading import reading, size_of
from salsanext_cli.records import Scan

KINDS = ("ascii", "binary", "binary_compressed")
TYPES = {
    **{f"F{size}": f"<f{size}" for size in (4, 8)},
    **{f"I{size}": f"<i{size}" for size in (1, 2, 4, 8)},
    **{f"U{size}": f"<u{size}" for size in (1, 2, 4, 8)},
}
PADDING = "_"
LONGEST_LINE = 1 << 16


@dataclass(frozen=True, slots=True)
class Header:
    """What a PCD file says of itself: fields in order of storage, number of points, encoding."""

    names: tuple[str, ...]
    types: tuple[str, ...]
    counts: tuple[int, ...]
    points: int
    kind: str

    @property
    def row(self) -> np.dtype[Any]:
        """One point as plain binary stores it, without the padding fields."""
        sizes = [
            np.dtype(t).itemsize * count for t, count in zip(self.types, self.counts, strict=True)
        ]
        return np.dtype(
            {
                "names": [self.names[i] for i in self.scalars],
                "formats": [self.types[i] for i in self.scalars],
                "offsets": [sum(sizes[:i]) for i in self.scalars],
                "itemsize": sum(sizes),
            }
        )

    @property
    def scalars(self) -> list[int]:
        """Which fields hold one named value per point."""
        return [
            i
            for i, (name, count) in enumerate(zip(self.names, self.counts, strict=True))
            if name != PADDING and count == 1
        ]


def read_pcd(path: Path, *, intensity_scale: float = 1.0) -> Scan:
    """Read a PCD file; intensities of one byte are divided by 255, without any they are 0.

    Raises
    ------
    FormatError
        If the file cannot be read, is cut off, or has no x, y and z.
    MissingDependency
        If the file is compressed and open3d cannot be imported.
    """
    with reading(path) as file:
        try:
            header = _read_header(file)
            match header.kind:
                case "ascii":
                    columns = _read_ascii(file, header)
                case "binary":
                    columns = _read_binary(file, header)
                case _:
                    columns = _read_compressed(file, path, header)
        except ValueError as error:
            raise FormatError(path, str(error), "a whole PCD file") from error
    return scan_of(columns, path, intensity_scale)


def _read_header(file: BinaryIO) -> Header:
    entries: dict[str, list[str]] = {}
    while "DATA" not in entries:
        line = file.readline(LONGEST_LINE)
        if not line:
            raise ValueError("no PCD header")
        words = line.decode("ascii", "replace").split()
        if words and not words[0].startswith("#"):
            entries[words[0].upper()] = words[1:]
    try:
        names = tuple(entries["FIELDS"])
        types = tuple(
            TYPES[kind + size] for kind, size in zip(entries["TYPE"], entries["SIZE"], strict=True)
        )
        counts = tuple(int(count) for count in entries.get("COUNT", ["1"] * len(names)))
        size = entries.get("POINTS") or entries["WIDTH"] + entries["HEIGHT"]
        header = Header(names, types, counts, math.prod(map(int, size)), entries["DATA"][0].lower())
    except (KeyError, IndexError) as error:
        raise ValueError(f"a PCD header without a usable {error}") from error
    _require_consistent(header)
    return header


def _require_consistent(header: Header) -> None:
    if not len(header.names) == len(header.types) == len(header.counts):
        raise ValueError("a PCD header whose FIELDS, TYPE, SIZE and COUNT differ in length")
    named = [name for name in header.names if name != PADDING]
    if len(set(named)) < len(named):
        raise ValueError("a PCD header with a field twice")
    if header.points < 0 or min(header.counts, default=0) < 0:
        raise ValueError("a PCD header with a negative number")
    if header.kind not in KINDS:
        raise ValueError(f"PCD data of kind {header.kind}, not {', '.join(KINDS)}")


def _read_ascii(file: BinaryIO, header: Header) -> Columns:
    text = file.read()
    width = sum(header.counts)
    values: npt.NDArray[np.float64] = np.empty((0, width))
    if text.strip():
        try:
            values = np.loadtxt(io.BytesIO(text), np.float64, comments=None, ndmin=2)
        except ValueError as error:
            raise ValueError("lines that do not hold the same count of numbers") from error
    if values.shape != (header.points, width):
        found = f"{len(values)} lines of {values.shape[1]} values"
        raise ValueError(f"{found}, not {header.points} of {width}")
    first = np.cumsum((0, *header.counts))
    # A NaN in an integer field that nobody reads is no reason to fail.
    with np.errstate(invalid="ignore", over="ignore"):
        return {
            header.names[i]: values[:, first[i]].astype(header.types[i]) for i in header.scalars
        }


def _read_binary(file: BinaryIO, header: Header) -> Columns:
    promised = header.points * header.row.itemsize
    if (held := size_of(file) - file.tell()) < promised:
        raise ValueError(f"{held} bytes of data, not {promised}")
    table = np.fromfile(file, header.row, header.points)
    return {name: table[name] for name in table.dtype.names or ()}


def _read_compressed(file: BinaryIO, path: Path, header: Header) -> Columns:
    if len(header.scalars) < len(header.names):
        raise ValueError("compressed PCD data with fields of several values")
    sizes = np.fromfile(file, "<u4", 2)
    promised = header.points * header.row.itemsize
    held = size_of(file) - file.tell()
    if len(sizes) < 2 or held < sizes[0] or sizes[1] != promised:
        raise ValueError(f"{held} bytes of compressed data that do not unpack to {promised}")
    if header.points == 0:
        return {name: np.empty(0, t) for name, t in zip(header.names, header.types, strict=True)}
    open3d = import_open3d()
    with open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error):
        cloud = open3d.t.io.read_point_cloud(str(path), format="pcd")
    if "positions" not in cloud.point or len(cloud.point.positions) != header.points:
        raise ValueError("compressed PCD data that does not unpack")
    columns = {name: cloud.point[name].numpy()[:, 0] for name in cloud.point}
    return columns | dict(zip("xyz", cloud.point.positions.numpy().T, strict=True))


def import_open3d() -> Any:
    """Import open3d, which takes over a second and needs a system library.

    Raises
    ------
    MissingDependency
        If it cannot be imported.
    """
    try:
        import open3d
    except ModuleNotFoundError as error:
        raise MissingDependency("open3d", "not installed", remedy="pip install open3d") from error
    except (ImportError, OSError) as error:
        raise MissingDependency(
            "open3d", str(error), "the system library libusb-1.0", "apt-get install libusb-1.0-0"
        ) from error
    return open3d
