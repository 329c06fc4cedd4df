# SPDX-License-Identifier: MIT
"""Messages with some of the points of a cloud, and clouds with further values of each point."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.records import Mask
from salsanext_cli.io.files.reading import refusing_damage
from salsanext_cli.io.formats.columns import Columns, other_number
from salsanext_cli.io.formats.ros.cloud_messages import (
    CLOUD_MESSAGES,
    EXPECTED,
    POINT_CLOUD2,
    TYPES,
    point_count,
    row_step,
)

CODES = {np.dtype(kind): code for code, kind in TYPES.items()}
"""Codes of PointField by the type of a column."""
ALIGNMENT = 4  # Bytes; the values of a point begin at a multiple of it


def cloud_subset(message: Any, mask: Mask, path: Path) -> Any:
    """Return a cloud with some of its points, whose bytes and order do not change.

    Parameters
    ----------
    message : PointCloud2, PointCloud or CustomMsg
        Cloud of N points; an organised one becomes one row.
    mask : ndarray of bool (N,)
        Remaining points.
    path : Path
        Scan in the bag, for errors.

    Returns
    -------
    message of the same type

    Raises
    ------
    FormatError
        If the sizes in the message contradict each other.
    LabelError
        If the mask is of another number of points.
    """
    _require_count(message, len(mask), path)
    CLOUD_MESSAGES[message.__msgtype__](message, path)  # Refuses a damaged one.
    if message.__msgtype__ == POINT_CLOUD2:
        points = _points_of(message, path)[mask]
        data = points.ravel()
        return replace(message, height=1, width=len(points), row_step=data.size, data=data)
    remaining = [message.points[index] for index in np.flatnonzero(mask)]
    if hasattr(message, "channels"):
        channels = [replace(old, values=old.values[mask]) for old in message.channels]
        return replace(message, points=remaining, channels=channels)
    return replace(message, points=remaining, point_num=len(remaining))


def cloud_with_values(message: Any, values: Columns, path: Path, types: Mapping[str, Any]) -> Any:
    """Return a PointCloud2 of the points of a cloud with further values of each.

    The fields of a PointCloud2 stay, but those with the name of a new value; clouds of other
    types have their columns as fields. Header and rows are those of the cloud.

    Parameters
    ----------
    message : PointCloud2, PointCloud or CustomMsg
        Cloud of N points.
    values : mapping of str to ndarray (N,)
        New values by name, of a type of PointField.
    path : Path
        Scan in the bag, for errors.
    types : mapping
        Classes of the messages of rosbags by name.

    Returns
    -------
    PointCloud2

    Raises
    ------
    FormatError
        If the sizes in the message contradict each other.
    LabelError
        If there is another number of values than points.
    """
    for column in values.values():
        _require_count(message, len(column), path)
    columns = CLOUD_MESSAGES[message.__msgtype__](message, path)
    height = 1
    is_bigendian = False
    if message.__msgtype__ == POINT_CLOUD2:
        points = _points_of(message, path)
        height = message.height
        is_bigendian = message.is_bigendian
        fields = [field for field in message.fields if field.name not in values]
    else:
        points, fields = _packed(columns, types)
    width = point_count(message) // height if height else 0
    start = -(-points.shape[1] // ALIGNMENT) * ALIGNMENT
    padding = np.zeros((len(points), start - points.shape[1]), np.uint8)
    added, added_fields = _packed(values, types, start=start, is_bigendian=is_bigendian)
    data = np.hstack([points, padding, added])
    return types[POINT_CLOUD2](
        header=_header(message.header, types),
        height=height,
        width=width,
        fields=[*(_field(field, types) for field in fields), *added_fields],
        is_bigendian=is_bigendian,
        point_step=data.shape[1],
        row_step=width * data.shape[1],
        data=data.ravel(),
        is_dense=getattr(message, "is_dense", False),
    )


def _require_count(message: Any, count: int, path: Path) -> None:
    """Refuse labels of another number of points."""
    points = point_count(message)
    if points != count:
        raise other_number(points, count, path)


def _points_of(message: Any, path: Path) -> npt.NDArray[np.uint8]:
    """Return the bytes of each point of a PointCloud2, (N, point_step), without the row padding."""
    height = message.height
    width = message.width
    step = message.point_step
    with refusing_damage(path, EXPECTED):
        data = np.asarray(message.data, np.uint8)
        strides = (row_step(message), step, 1)
        points = np.ndarray((height, width, step), np.uint8, data, 0, strides)
    return points.reshape(height * width, step)


def _packed(
    columns: Columns, types: Mapping[str, Any], *, start: int = 0, is_bigendian: bool = False
) -> tuple[npt.NDArray[np.uint8], list[Any]]:
    """Return columns (N,) as bytes of each point, (N, B), and their fields from byte `start`."""
    order: Literal["<", ">"] = ">" if is_bigendian else "<"
    field = types["sensor_msgs/msg/PointField"]
    blocks = []
    fields = []
    offset = start
    for name, values in columns.items():
        kind = values.dtype.newbyteorder("=")
        block = np.ascontiguousarray(values, kind.newbyteorder(order)).view(np.uint8)
        blocks.append(block.reshape(len(values), kind.itemsize))
        fields.append(field(name=name, offset=offset, datatype=CODES[kind], count=1))
        offset += kind.itemsize
    return np.hstack(blocks), fields


def _field(field: Any, types: Mapping[str, Any]) -> Any:
    """Return a field as one of other classes of messages."""
    return types["sensor_msgs/msg/PointField"](
        name=field.name, offset=field.offset, datatype=field.datatype, count=field.count
    )


def _header(header: Any, types: Mapping[str, Any]) -> Any:
    """Return a header as one of other classes of messages; that of ROS 1 has a number."""
    kind = types["std_msgs/msg/Header"]
    time = types["builtin_interfaces/msg/Time"]
    stamp = time(sec=header.stamp.sec, nanosec=header.stamp.nanosec)
    numbered = {"seq": getattr(header, "seq", 0)} if "seq" in kind.__dataclass_fields__ else {}
    return kind(stamp=stamp, frame_id=header.frame_id, **numbered)
