# SPDX-License-Identifier: MIT
"""PCD files from columns: binary, or ascii for programs that read no other form."""

import io
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

EXACT_FLOAT32 = "%.9g"  # Nine digits give a float32 back


def encode_pcd(columns: Mapping[str, npt.NDArray[Any]], *, text: bool = False) -> bytes:
    """Return points as an uncompressed PCD file of version 0.7.

    Parameters
    ----------
    columns : mapping of str to (N,) array
        Fields by name, in order: float32, or integers of up to 4 bytes.
    text : bool
        Whether the file is ascii instead of binary.

    Returns
    -------
    bytes
    """
    point_type = np.dtype([(name, values.dtype) for name, values in columns.items()])
    point_count = len(next(iter(columns.values())))
    points = np.empty(point_count, point_type.newbyteorder("<"))
    for name, values in columns.items():
        points[name] = values
    types = [values.dtype for values in columns.values()]
    header = (
        "# .PCD v0.7 - Point Cloud Data file format\n"
        "VERSION 0.7\n"
        f"FIELDS {' '.join(columns)}\n"
        f"SIZE {' '.join(str(dtype.itemsize) for dtype in types)}\n"
        f"TYPE {' '.join(dtype.kind.upper() for dtype in types)}\n"
        f"COUNT {' '.join('1' for _ in types)}\n"
        f"WIDTH {point_count}\n"
        "HEIGHT 1\n"
        "VIEWPOINT 0 0 0 1 0 0 0\n"
        f"POINTS {point_count}\n"
        f"DATA {'ascii' if text else 'binary'}\n"
    )
    return header.encode("ascii") + (_lines(points) if text else points.tobytes())


def _lines(points: npt.NDArray[Any]) -> bytes:
    """Return a line for each point of a structured array."""
    kinds = [points.dtype[name].kind for name in points.dtype.names or ()]
    with io.BytesIO() as lines:
        np.savetxt(lines, points, [EXACT_FLOAT32 if kind == "f" else "%d" for kind in kinds])
        return lines.getvalue()
