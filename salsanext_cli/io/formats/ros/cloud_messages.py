# SPDX-License-Identifier: MIT
"""Messages of ROS that contain the points of a scan, decoded to columns."""

from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from salsanext_cli.io.files.reading import refusing_damage
from salsanext_cli.io.formats.columns import Columns

POINT_CLOUD2 = "sensor_msgs/msg/PointCloud2"
POINT_CLOUD = "sensor_msgs/msg/PointCloud"
LIVOX_PACKAGES = ("livox_ros_driver", "livox_ros_driver2", "livox_interfaces")
CUSTOM_MESSAGE = """\
std_msgs/Header header
uint64 timebase
uint32 point_num
uint8 lidar_id
uint8[3] rsvd
CustomPoint[] points
"""
CUSTOM_POINT = """\
uint32 offset_time
float32 x
float32 y
float32 z
uint8 reflectivity
uint8 tag
uint8 line
"""
TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""NumPy's names of the types of a field."""
EXPECTED = "a complete cloud"


@cache
def default_types() -> Any:
    """Return the typestore of rosbags for bags without definitions, with the messages of Livox.

    All readers of a process share it, since they only copy from it; parsing the messages takes
    longer than opening a small bag.
    """
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    # Databases from before 2023 lack definitions; clouds have the same one in all releases.
    types = get_typestore(Stores.ROS2_JAZZY)
    for package in LIVOX_PACKAGES:
        point = get_types_from_msg(CUSTOM_POINT, f"{package}/msg/CustomPoint")
        message = get_types_from_msg(CUSTOM_MESSAGE, f"{package}/msg/CustomMsg")
        types.register({**point, **message})
    return types


def columns_of_fields(message: Any, path: Path) -> Columns:
    """Return the columns of a PointCloud2 message, as views into it.

    Parameters
    ----------
    message : PointCloud2
        N points, in rows that may be padded. The first of two fields of one name counts, and
        fields of several values are skipped.
    path : Path
        Scan in the bag, for errors.

    Returns
    -------
    Columns
        Values (N,) of each field, by name.

    Raises
    ------
    FormatError
        If the sizes in the message contradict each other.
    """
    height = message.height
    width = message.width
    step = message.point_step
    order = ">" if message.is_bigendian else "<"
    with refusing_damage(path, EXPECTED):
        bytes_of_row = row_step(message)
        size = (height - 1) * bytes_of_row + width * step if height and width else 0
        if len(message.data) < size:
            raise ValueError(f"{len(message.data)} bytes of data, not {size}")
        fields: dict[str, tuple[str, int]] = {}
        for field in message.fields:
            if field.count <= 1:  # Old drivers write 0.
                fields.setdefault(field.name, (order + TYPES[field.datatype], field.offset))
        point = np.dtype(
            {
                "names": list(fields),
                "formats": [kind for kind, _ in fields.values()],
                "offsets": [offset for _, offset in fields.values()],
                "itemsize": step,
            }
        )
        data = np.asarray(message.data, np.uint8)
        points = np.ndarray((height, width), point, data, 0, (bytes_of_row, step))
    return {name: points[name].ravel() for name in fields}


def row_step(message: Any) -> int:
    """Return the bytes from row to row of a PointCloud2 message."""
    row = int(message.width * message.point_step)
    # Some drivers write 0, or the size of the whole cloud.
    if message.height <= 1 or len(message.data) == message.height * row:
        return row
    if message.row_step < row:
        points = f"{message.width} points of {message.point_step}"
        raise ValueError(f"rows of {message.row_step} bytes for {points}")
    return int(message.row_step)


def columns_of_channels(message: Any, path: Path) -> Columns:
    """Return the columns (N,) of a PointCloud message: the coordinates and its channels."""
    with refusing_damage(path, EXPECTED):
        columns = _attributes(message.points, {"x": "f4", "y": "f4", "z": "f4"})
        for channel in message.channels:
            if len(channel.values) != len(message.points):
                counts = f"{len(channel.values)} values for {len(message.points)} points"
                raise ValueError(f"channel {channel.name} has {counts}")
            columns.setdefault(channel.name, np.asarray(channel.values, np.float32))
    return columns


def columns_of_livox(message: Any, path: Path) -> Columns:
    """Return the columns (N,) of a CustomMsg of Livox: the coordinates and the reflectivity."""
    with refusing_damage(path, EXPECTED):
        kinds = {"x": "f4", "y": "f4", "z": "f4", "reflectivity": "u1"}
        return _attributes(message.points, kinds)


def _attributes(points: Any, kinds: Mapping[str, str]) -> dict[str, Any]:
    """Return attributes of N points as arrays (N,) of some types, by name."""
    return {
        name: np.fromiter((getattr(point, name) for point in points), kind, len(points))
        for name, kind in kinds.items()
    }


CLOUD_MESSAGES: Mapping[str, Callable[[Any, Path], Columns]] = {
    POINT_CLOUD2: columns_of_fields,
    POINT_CLOUD: columns_of_channels,
    **{f"{package}/msg/CustomMsg": columns_of_livox for package in LIVOX_PACKAGES},
}
"""Decoders of a message by its type, to columns (N,) by name."""


def point_count(message: Any) -> int:
    """Return the number of points in a message of one of the `CLOUD_MESSAGES`."""
    if hasattr(message, "width"):
        return int(message.height * message.width)
    return len(message.points)
