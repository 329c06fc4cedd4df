# SPDX-License-Identifier: MIT
"""PLY clouds through plyfile, which is GPL and therefore imported here only, when it is used.

plyfile allocates whatever a header promises, so the header is compared with the file's size first.
"""

import io
import re
import warnings
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.errors import FormatError, MissingDependency, shortened
from salsanext_cli.files.reading import reading
from salsanext_cli.formats.columns import Columns, scan_of
from salsanext_cli.records import Scan

START = re.compile(rb"ply(\r\n|\r|\n)")
"""First line, with the line end of the whole header."""
MAX_HEADER_BYTES = 1 << 20
SIZES = {
    **dict.fromkeys(("char", "int8", "uchar", "uint8"), 1),
    **dict.fromkeys(("short", "int16", "ushort", "uint16"), 2),
    **dict.fromkeys(("int", "int32", "uint", "uint32", "float", "float32"), 4),
    **dict.fromkeys(("double", "float64"), 8),
}
"""Bytes of each type in a binary file; other types are refused when they are read."""
MIN_ASCII_BYTES = 2
"""Bytes of a value in an ascii file: a digit and a blank or a line end."""


def read_ply(path: Path, *, intensity_scale: float = 1.0) -> Scan:
    """Read the vertices of a PLY file; without an intensity it is 0."""
    return scan_of(ply_columns(path), path, intensity_scale)


def ply_columns(path: Path) -> Columns:
    """Read the properties of the vertices of a PLY file; errors are those of `read_ply`."""
    plyfile = _plyfile()
    with reading(path) as file:
        content = file.read()
    try:
        _require_room(content)
        with warnings.catch_warnings():
            # plyfile warns of empty lines before it refuses them.
            warnings.simplefilter("ignore")
            data = plyfile.PlyData.read(io.BytesIO(content))
    except (plyfile.PlyParseError, ValueError, OverflowError) as error:
        raise FormatError(
            path, f"not a whole PLY file: {shortened(str(error))}", "a .ply file"
        ) from error
    if "vertex" not in data:
        raise FormatError(path, "no vertices", "a PLY file with an element vertex")
    vertices = data["vertex"].data
    return {name: vertices[name] for name in vertices.dtype.names or ()}


def _require_room(content: bytes) -> None:
    """Raise `ValueError` if the elements of a PLY file cannot all be in its content.

    Other errors of its header are left to plyfile.
    """
    start = START.match(content)
    end = content.find(start[1] + b"end_header" + start[1], 0, MAX_HEADER_BYTES) if start else -1
    if start is None or end < 0:
        raise ValueError("no PLY header")
    text = content[start.end() : end].decode("ascii")
    # Split as plyfile does, so that both find the same elements.
    lines = [line.split() for line in text.split(start[1].decode())]
    ascii_file = ["format", "ascii"] in (words[:2] for words in lines)
    room = len(content) - end
    for count, row in _elements(lines, ascii_file):
        # A row without properties has no bytes, but takes time.
        room -= count * max(row, 1)
        if count < 0 or room < 0:
            raise ValueError("the header promises more than the file holds")


def _elements(lines: list[list[str]], ascii_file: bool) -> list[tuple[int, int]]:
    """Return the number of rows of each element, and the least number of bytes of a row."""
    elements: list[tuple[int, int]] = []
    for words in lines:
        if words[:1] == ["element"] and len(words) == 3:
            elements.append((int(words[2]), 0))
        elif words[:1] == ["property"] and len(words) > 1 and elements:
            count, row = elements[-1]
            # A list has at least its length.
            kind = words[2] if words[1] == "list" and len(words) > 2 else words[1]
            size = MIN_ASCII_BYTES if ascii_file else SIZES.get(kind, 1)
            elements[-1] = (count, row + size)
    return elements


def encode_ply(columns: Mapping[str, npt.NDArray[Any]], comments: Iterable[str] = ()) -> bytes:
    """Return vertices as a binary little endian PLY file, one property per column, in order.

    `columns`: values by property name, any real dtype. They become uchar, int, float or double, the
    only types that open3d reads: integers wider than a byte become int, or double beyond its range;
    `comments`: lines of the header; anything outside ASCII is escaped.
    """
    plyfile = _plyfile()
    readable = {name: _readable(values) for name, values in columns.items()}
    table = np.empty(
        len(next(iter(readable.values()))), [(name, v.dtype) for name, v in readable.items()]
    )
    for name, values in readable.items():
        table[name] = values
    lines = [" ".join(c.split()).encode("ascii", "backslashreplace").decode() for c in comments]
    element = plyfile.PlyElement.describe(table, "vertex")
    with io.BytesIO() as buffer:
        plyfile.PlyData([element], text=False, byte_order="<", comments=lines).write(buffer)
        return buffer.getvalue()


def _readable(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Convert values to a type that open3d reads."""
    if values.dtype.kind in "iu" and values.itemsize + (values.dtype.kind == "i") > 1:
        limits = np.iinfo(np.int32)
        fits = not len(values) or (values.min() >= limits.min and values.max() <= limits.max)
        return values.astype(np.int32 if fits else np.float64)
    smaller = {np.dtype(bool): np.uint8, np.dtype(np.float16): np.float32}
    return values.astype(smaller.get(values.dtype, values.dtype), copy=False)


def _plyfile() -> Any:
    try:
        import plyfile
    except ImportError as error:
        raise MissingDependency("plyfile", "not installed", remedy="pip install plyfile") from error
    return plyfile
