# SPDX-License-Identifier: MIT
"""Columns of a ROS message of type sensor_msgs/PointCloud2."""

from pathlib import Path
from typing import Any

import numpy as np

from salsanext_cli.errors import FormatError
from salsanext_cli.formats.columns import Columns, rows_as_rings

POINT_CLOUD2 = "sensor_msgs/msg/PointCloud2"
TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""NumPy's names of the types of a field."""


def columns_of(message: Any, path: Path) -> Columns:
    """Return the values of each field of one value per point, as views into the message.

    `message`: rows may be padded, points too; those of an organised cloud follow row by row;
    `path`: named in errors.

    Returns dict of str to (N,) array, by the field's name; of two of one name, the first. The row
    of an organised cloud is its ring, unless a field says otherwise.
    """
    height, width, step = message.height, message.width, message.point_step
    row = message.row_step if height > 1 else width * step
    held, claimed = len(message.data), max(height - 1, 0) * row + width * step if height else 0
    if claimed > held or row < width * step:
        found = f"{height}×{width} points of {step} bytes, rows of {row}, in {held} bytes"
        raise FormatError(path, found, "a cloud as large as it says", "it is damaged")
    types = _types(message, path)
    order = ">" if message.is_bigendian else "<"
    data = np.asarray(message.data, np.uint8)
    if height == 0 or width == 0:
        return {name: np.empty(0, order + kind) for name, (kind, _) in types.items()}
    # Without fields, points take no room, however many there are.
    rings = rows_as_rings(height * width, height) if types else {}
    return rings | {
        name: np.ndarray((height, width), order + kind, data, offset, (row, step)).ravel()
        for name, (kind, offset) in types.items()
    }


def _types(message: Any, path: Path) -> dict[str, tuple[str, int]]:
    """Return NumPy's type and the offset of each field of one value by its name."""
    found: dict[str, tuple[str, int]] = {}
    for field in message.fields:
        kind = TYPES.get(field.datatype, "")
        if not kind or field.offset + np.dtype(kind).itemsize > message.point_step:
            wrong = f"field {field.name!r:.80} of type {field.datatype} at byte {field.offset}"
            expected = f"types 1 to 8 within the {message.point_step} bytes of a point"
            raise FormatError(path, wrong, expected, "it is damaged")
        if field.count <= 1:  # Old drivers write 0.
            found.setdefault(field.name, (kind, field.offset))
    return found
