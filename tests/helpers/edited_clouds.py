# SPDX-License-Identifier: MIT
"""Clouds with scalars in the form of labelling tools, not written by salsanext."""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import plyfile
from las_files import write_las

Array = npt.NDArray[Any]
Scalars = Mapping[str, Array]


def _table(points: Array, scalars: Scalars, kind: str) -> Array:
    columns = dict(zip("xyz", points.T.astype(kind), strict=True)) | dict(scalars)
    table = np.empty(len(points), [(name, values.dtype) for name, values in columns.items()])
    for name, values in columns.items():
        table[name] = values
    return table


def write_ply(
    path: Path, points: Array, scalars: Scalars, *, text: bool = False, kind: str = "f4"
) -> Path:
    """Write points (M, 3) and scalars (M,) as vertices."""
    element = plyfile.PlyElement.describe(_table(points, scalars, kind), "vertex")
    path.parent.mkdir(parents=True, exist_ok=True)
    plyfile.PlyData([element], text=text).write(path)
    return path


def write_pcd(path: Path, points: Array, scalars: Scalars, *, form: str = "binary") -> Path:
    """Write points (M, 3) and scalars (M,) as fields."""
    table = _table(points, scalars, "<f4")
    columns = [table[name] for name in table.dtype.names or ()]
    kinds = {"f": "F", "i": "I", "u": "U"}
    header = (
        f"VERSION .7\nFIELDS {' '.join(table.dtype.names or ())}\n"
        f"SIZE {' '.join(str(v.itemsize) for v in columns)}\n"
        f"TYPE {' '.join(kinds[v.dtype.kind] for v in columns)}\n"
        f"WIDTH {len(table)}\nHEIGHT 1\nPOINTS {len(table)}\nDATA {form}\n"
    )
    rows = "\n".join(" ".join(map(str, row)) for row in table.tolist())
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(header.encode() + (table.tobytes() if form == "binary" else rows.encode()))
    return path


def write_labelled_las(path: Path, points: Array, scalars: Scalars) -> Path:
    """Write points (M, 3), in whole millimetres, and scalars (M,), mostly extra dimensions."""
    own = {name: values for name, values in scalars.items() if name == "classification"}
    extra = {name: values for name, values in scalars.items() if name not in own}
    return write_las(path, points, extra=extra, **own)


WRITERS: dict[str, Callable[[Path, Array, Scalars], Path]] = {
    "s.ply": write_ply,
    "S.PLY": partial(write_ply, text=True, kind="f8"),
    "s.pcd": write_pcd,
    "t.pcd": partial(write_pcd, form="ascii"),
    "s.las": write_labelled_las,
    "s.laz": write_labelled_las,
}
"""Writers by the names of files."""
