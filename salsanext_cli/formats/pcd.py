# SPDX-License-Identifier: MIT
"""PCD clouds: ascii, binary and binary_compressed.

open3d only unpacks compressed data, of a copy with a header in the usual form: it writes beyond its
memory where HEIGHT comes after POINTS and on padding fields (`_` with COUNT ≠ 1), and fills clouds
with uninitialised values where ascii files are short or DATA is in upper case.
"""

from __future__ import annotations

import io
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import BinaryIO

import numpy as np
import numpy.typing as npt

from salsanext_cli.errors import FormatError
from salsanext_cli.formats.columns import Columns, scan_of
from salsanext_cli.formats.pcd_header import Header, read_header
from salsanext_cli.formats.reading import read_values, reading, size_of
from salsanext_cli.packages import import_open3d
from salsanext_cli.records import Scan
from salsanext_cli.settings_files import shortened

LARGEST_RATIO = 264 / 3
"""Largest compression ratio of LZF: three bytes stand for up to 264."""


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
            header = read_header(file)
            match header.kind:
                case "ascii":
                    columns = _read_ascii(file, header)
                case "binary":
                    columns = _read_binary(file, path, header)
                case _:
                    columns = _read_compressed(file, header)
        except ValueError as error:
            raise FormatError(path, shortened(str(error)), "a whole PCD file") from error
    return scan_of(columns, path, intensity_scale)


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
    # A NaN in an integer field that is not used is no reason to fail.
    with np.errstate(invalid="ignore", over="ignore"):
        return {
            header.names[i]: values[:, first[i]].astype(header.types[i]) for i in header.scalars
        }


def _read_binary(file: BinaryIO, path: Path, header: Header) -> Columns:
    promised = header.points * header.row_size
    if (held := size_of(file) - file.tell()) < promised:
        raise ValueError(f"{held} bytes of data, not {promised}")
    table = read_values(file, path, header.row, header.points)
    return {name: table[name] for name in table.dtype.names or ()}


def _read_compressed(file: BinaryIO, header: Header) -> Columns:
    if len(header.scalars) < len(header.names):
        raise ValueError("compressed PCD data with fields of several values")
    sizes = np.fromfile(file, "<u4", 2)
    promised = header.points * header.row_size
    held = size_of(file) - file.tell()
    if len(sizes) < 2 or held < sizes[0] or sizes[1] != promised:
        raise ValueError(f"{held} bytes of compressed data that do not unpack to {promised}")
    if promised > LARGEST_RATIO * sizes[0]:
        raise ValueError(f"{sizes[0]} bytes of compressed data that cannot unpack to {promised}")
    if header.points == 0:
        return {name: np.empty(0, t) for name, t in zip(header.names, header.types, strict=True)}
    open3d = import_open3d()
    with (
        NamedTemporaryFile(suffix=".pcd") as copy,
        open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error),
    ):
        copy.write(header.encode() + sizes.tobytes() + file.read(sizes[0]))
        copy.flush()
        try:
            cloud = open3d.t.io.read_point_cloud(copy.name, format="pcd")
        except RuntimeError as error:
            raise ValueError("compressed PCD data that open3d cannot take") from error
    if "positions" not in cloud.point or len(cloud.point.positions) != header.points:
        raise ValueError("compressed PCD data that does not unpack")
    columns = {name: cloud.point[name].numpy()[:, 0] for name in cloud.point}
    return columns | dict(zip("xyz", cloud.point.positions.numpy().T, strict=True))
