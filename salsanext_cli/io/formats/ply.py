# SPDX-License-Identifier: MIT
"""PLY clouds through plyfile, which is GPL and therefore only imported here, when it is used."""

import io
import re
import warnings
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.errors import FormatError
from salsanext_cli.core.optional_packages import import_package
from salsanext_cli.io.files.atomic import write_bytes
from salsanext_cli.io.files.reading import reading, refusing_damage
from salsanext_cli.io.formats.columns import Columns

MAX_HEADER_BYTES = 1 << 20
COUNT = re.compile(rb"(?:^|[\r\n])\s*element\s+(\S+)\s+(\S+)")
"""Name and number of the elements of a kind."""
BLANKS = re.compile(rb"[ \t]+(?=[\r\n])")  # Blanks at the end of a line, which plyfile refuses
ASCII = re.compile(rb"[\r\n]\s*format\s+ascii\s")
BLANK_LINES = re.compile(rb"(?<=\n)[ \t\r]*\n|(?<=\r)[ \t]*\r(?!\n)")
"""Lines without values among those of an ascii file, which plyfile refuses."""


def ply_columns(path: Path, _: tuple[str, ...] = ()) -> Columns:
    """Read the properties of the vertices of a PLY file."""
    with reading(path) as file:
        data = read_ply(path, file.read())
    vertices = data["vertex"].data
    return {name: vertices[name] for name in vertices.dtype.names or ()}


def read_ply(path: Path, content: bytes) -> Any:
    """Return the elements of a PLY file with vertices, as `plyfile.PlyData`."""
    plyfile = import_package("plyfile")
    with refusing_damage(path, "a complete .ply file"), warnings.catch_warnings():
        # plyfile warns of empty lines before it refuses them.
        warnings.simplefilter("ignore")
        end = content.find(b"end_header", 0, MAX_HEADER_BYTES)
        if end < 0:
            raise ValueError("no PLY header")
        elements = [(name, int(count)) for name, count in COUNT.findall(content[:end])]
        # plyfile allocates the stated numbers.
        if any(n < 0 for _, n in elements) or sum(n for _, n in elements) > len(content):
            raise ValueError("its header states more than it contains")
        if not any(name == b"vertex" for name, _ in elements):
            raise FormatError(path, "has no vertices", "a PLY file with an element vertex")
        head = BLANKS.sub(b"", content[:end])
        body = content[end:]
        if ASCII.search(head):
            body = BLANK_LINES.sub(b"", body)
        return plyfile.PlyData.read(io.BytesIO(head + body))


def encode_ply(columns: Mapping[str, npt.NDArray[Any]], comments: Iterable[str] = ()) -> bytes:
    """Return vertices as a binary little-endian PLY file, one property per column, in order.

    `columns` (N,) of any real dtype become uchar, int, float or double, the only types that open3d
    reads: integers wider than a byte become int, or double beyond its range. In `comments`, lines
    of the header, all but ASCII is escaped.
    """
    plyfile = import_package("plyfile")
    readable = {name: _readable(values) for name, values in columns.items()}
    kinds = [(name, values.dtype) for name, values in readable.items()]
    table = np.rec.fromarrays(readable.values(), kinds)
    lines = [" ".join(c.split()).encode("ascii", "backslashreplace").decode() for c in comments]
    element = plyfile.PlyElement.describe(table, "vertex")
    with io.BytesIO() as buffer:
        plyfile.PlyData([element], text=False, byte_order="<", comments=lines).write(buffer)
        return buffer.getvalue()


def write_ply(
    path: Path, columns: Mapping[str, npt.NDArray[Any]], comments: Iterable[str] = ()
) -> None:
    """Write points and their scalars as a binary little-endian PLY file.

    An existing file is replaced.

    Parameters
    ----------
    path : Path
        The `.ply` file.
    columns : dict of str to (N,) array
        Properties by name, x, y, z in metres first. Integers wider than a byte become int, or
        double beyond its range.
    comments : iterable of str, optional
        Lines of the header; all but ASCII is escaped.
    """
    write_bytes(path, encode_ply(columns, comments))


def _readable(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Convert values to a type that open3d reads."""
    if values.dtype.kind in "iu" and values.itemsize + (values.dtype.kind == "i") > 1:
        limits = np.iinfo(np.int32)
        fits = not len(values) or (values.min() >= limits.min and values.max() <= limits.max)
        return values.astype(np.int32 if fits else np.float64)
    smaller = {np.dtype(bool): np.uint8, np.dtype(np.float16): np.float32}
    return values.astype(smaller.get(values.dtype, values.dtype), copy=False)
