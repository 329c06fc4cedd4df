# SPDX-License-Identifier: MIT
"""PLY clouds through plyfile, which is GPL and therefore imported here only, when it is used."""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.errors import FormatError, MissingDependency
from salsanext_cli.formats.atomic import writing
from salsanext_cli.formats.columns import scan_of
from salsanext_cli.formats.reading import reading
from salsanext_cli.records import Scan


def read_ply(path: Path, *, intensity_scale: float = 1.0) -> Scan:
    """Read the vertices of a PLY file; without an intensity it is 0.

    Raises
    ------
    FormatError
        If the file cannot be read, is cut off, or has no vertices with x, y and z.
    MissingDependency
        If plyfile is not installed.
    """
    vertices = _read_vertices(path)
    columns = {name: vertices[name] for name in vertices.dtype.names or ()}
    return scan_of(columns, path, intensity_scale)


def _read_vertices(path: Path) -> npt.NDArray[Any]:
    """Return the vertices as a structured array in memory."""
    plyfile = _plyfile()
    with reading(path) as file:
        try:
            data = plyfile.PlyData.read(file)
        # A header may promise more memory than there is.
        except (plyfile.PlyParseError, ValueError, MemoryError) as error:
            raise FormatError(
                path, f"not a whole PLY file: {str(error) or 'too large'}", "a .ply file"
            ) from error
        if "vertex" not in data:
            raise FormatError(path, "no vertices", "a PLY file with an element vertex")
        return np.array(data["vertex"].data)


def write_ply(
    path: Path, columns: Mapping[str, npt.NDArray[Any]], comments: Iterable[str] = ()
) -> None:
    """Write vertices as binary little endian PLY, one property per column, in order.

    Parameters
    ----------
    path : Path
        The `.ply` file.
    columns : mapping of str to (N,) array
        Values by property name; the dtype is the property's type (8, 16, 32 bit integers, float32,
        float64).
    comments : iterable of str
        Lines of the header; anything outside ASCII is escaped.
    """
    plyfile = _plyfile()
    fields = [(name, values.dtype) for name, values in columns.items()]
    table = np.empty(len(next(iter(columns.values()))), fields)
    for name, values in columns.items():
        table[name] = values
    lines = [" ".join(c.split()).encode("ascii", "backslashreplace").decode() for c in comments]
    element = plyfile.PlyElement.describe(table, "vertex")
    with io.BytesIO() as buffer, writing(path) as file:
        plyfile.PlyData([element], text=False, byte_order="<", comments=lines).write(buffer)
        file.write(buffer.getbuffer())


def _plyfile() -> Any:
    try:
        import plyfile
    except ImportError as error:
        raise MissingDependency("plyfile", "not installed", remedy="pip install plyfile") from error
    return plyfile
