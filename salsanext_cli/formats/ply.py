# SPDX-License-Identifier: MIT
"""PLY clouds through plyfile, which is GPL and therefore imported here only, when it is used."""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.errors import FormatError, MissingDependency
from salsanext_cli.formats.columns import scan_of
from salsanext_cli.formats.ply_header import require_room
from salsanext_cli.formats.reading import reading
from salsanext_cli.records import Scan
from salsanext_cli.settings_files import shortened


def read_ply(path: Path, *, intensity_scale: float = 1.0) -> Scan:
    """Read the vertices of a PLY file; without an intensity it is 0.

    Raises
    ------
    FormatError
        If the file cannot be read, is cut off, or has no vertices with x, y and z.
    MissingDependency
        If plyfile is not installed.
    """
    plyfile = _plyfile()
    with reading(path) as file:
        content = file.read()
    try:
        require_room(content)
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
    columns = {name: vertices[name] for name in vertices.dtype.names or ()}
    return scan_of(columns, path, intensity_scale)


def encode_ply(columns: Mapping[str, npt.NDArray[Any]], comments: Iterable[str] = ()) -> bytes:
    """Return vertices as a binary little endian PLY file, one property per column, in order.

    Parameters
    ----------
    columns : mapping of str to (N,) array
        Values by property name, any real dtype. They become uchar, int, float or double, the only
        types that open3d reads: integers wider than a byte become int, or double beyond its range.
    comments : iterable of str
        Lines of the header; anything outside ASCII is escaped.
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
