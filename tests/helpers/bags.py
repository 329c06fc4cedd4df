# SPDX-License-Identifier: MIT
"""ROS bags for tests, written by rosbags."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from salsanext_cli.io.formats.ros.cloud_messages import POINT_CLOUD2, TYPES

START = 1_600_000_000_123_456_789
"""Time of the first message in nanoseconds."""
STEP = 100_000_000
TOPIC = "/velodyne_points"
CODES = {np.dtype(kind): code for code, kind in TYPES.items()}
KINDS = (".bag", ".db3", ".mcap")
LIVOX = {
    "CustomPoint": "uint32 offset_time\nfloat32 x\nfloat32 y\nfloat32 z\n"
    "uint8 reflectivity\nuint8 tag\nuint8 line\n",
    "CustomMsg": "std_msgs/Header header\nuint64 timebase\nuint32 point_num\nuint8 lidar_id\n"
    "uint8[3] rsvd\nCustomPoint[] points\n",
}
"""Definitions of the messages of Livox drivers, by name."""
VELODYNE = {
    "VelodynePacket": "time stamp\nuint8[1206] data\n",
    "VelodyneScan": "std_msgs/Header header\nVelodynePacket[] packets\n",
}
"""Definitions of the messages of Velodyne's driver for ROS 1, by name."""
Message = tuple[str, int, Any]
"""Topic, time, and function from the types of a version of ROS to the message."""


def cloud(points: np.ndarray, *, height: int = 1, row_padding: int = 0, **changed: Any) -> Any:
    """Return a function that makes a PointCloud2 of a structured array (N,) of one byte order.

    The message has its offsets and padding, `height` rows with `row_padding` bytes at their ends,
    and `changed` fields.
    """

    def make(types: Any) -> Any:
        step, width = points.dtype.itemsize, len(points) // height
        rows = np.zeros((height, width * step + row_padding), np.uint8)
        rows[:, : width * step] = points.view(np.uint8).reshape(height, -1)
        layout: dict[str, Any] = dict(points.dtype.fields or {})
        fields = [
            types["sensor_msgs/msg/PointField"](name, offset, CODES[kind.newbyteorder("=")], 1)
            for name, (kind, offset, *_) in layout.items()
        ]
        big = any(kind.byteorder == ">" for kind, *_ in layout.values())
        values = {
            "header": header(types),
            "height": height,
            "width": width,
            "fields": fields,
            "is_bigendian": big,
            "point_step": step,
            "row_step": rows.shape[1],
            "data": rows.ravel(),
            "is_dense": False,
        }
        return types[POINT_CLOUD2](**{**values, **changed})

    return make


def header(types: Any) -> Any:
    """Return a header of messages."""
    kind = types["std_msgs/msg/Header"]
    values = {"seq": 0, "stamp": types["builtin_interfaces/msg/Time"](1, 2), "frame_id": "lidar"}
    return kind(**{name: values[name] for name in kind.__dataclass_fields__ if name in values})


def livox(points: np.ndarray, package: str = "livox_ros_driver2") -> Any:
    """Return a function that makes a CustomMsg of a driver of Livox."""

    def make(types: Any) -> Any:
        point = types[f"{package}/msg/CustomPoint"]
        rows = points[["x", "y", "z", "intensity"]].tolist()
        of_message = [point(7, x, y, z, int(value), tag=0, line=1) for x, y, z, value in rows]
        kind = types[f"{package}/msg/CustomMsg"]
        return kind(header(types), 0, len(points), 0, np.zeros(3, np.uint8), of_message)

    return make


def channels(points: np.ndarray, *, missing: int = 0) -> Any:
    """Return a function that makes a PointCloud with a channel, of which values may be missing."""

    def make(types: Any) -> Any:
        coordinates = types["geometry_msgs/msg/Point32"]
        of_message = [coordinates(*row) for row in points[["x", "y", "z"]].tolist()]
        values = points["intensity"][missing:].copy()
        channel = types["sensor_msgs/msg/ChannelFloat32"]("intensity", values)
        return types["sensor_msgs/msg/PointCloud"](header(types), of_message, [channel])

    return make


def text(types: Any) -> Any:
    """Make a message that is not a cloud."""
    return types["std_msgs/msg/String"]("drive")


def packets(types: Any) -> Any:
    """Make a message of the packets of a Velodyne sensor, without any."""
    return types["velodyne_msgs/msg/VelodyneScan"](header(types), [])


def messages(points: Iterable[np.ndarray], topic: str = TOPIC) -> list[Message]:
    """Return messages of clouds, a tenth of a second apart."""
    return [(topic, START + n * STEP, cloud(each)) for n, each in enumerate(points)]


@cache
def types_of_ros(version: int) -> Any:
    """Return the types of a version of ROS and of drivers, which take longer than most bags."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if version == 1 else Stores.ROS2_JAZZY)
    for package in ("livox_ros_driver", "livox_ros_driver2"):
        for name, definition in LIVOX.items():
            store.register(get_types_from_msg(definition, f"{package}/msg/{name}"))
    for name, definition in VELODYNE.items():
        store.register(get_types_from_msg(definition, f"velodyne_msgs/msg/{name}"))
    return store


def write_bag(
    folder: Path, kind: str, written: Iterable[Message], *, compression: str = ""
) -> Path:
    """Write a bag `drive` of a kind, in chunks of a few messages.

    Returns the file, which for ROS 2 lies in a folder `drive`.
    """
    from rosbags import rosbag1, rosbag2

    is_ros1 = kind == ".bag"
    store = types_of_ros(1 if is_ros1 else 2)
    writer: Any
    if is_ros1:
        folder.mkdir(parents=True, exist_ok=True)
        writer = rosbag1.Writer(folder / "drive.bag")
        writer.chunk_threshold = 4096
        if compression:
            writer.set_compression(rosbag1.Writer.CompressionFormat[compression])
    else:
        plugin = rosbag2.StoragePlugin.MCAP if kind == ".mcap" else rosbag2.StoragePlugin.SQLITE3
        writer = rosbag2.Writer(folder / "drive", version=9, storage_plugin=plugin)
        if compression:
            mode = rosbag2.CompressionMode[compression]
            writer.set_compression(mode, rosbag2.CompressionFormat.ZSTD)
    connections: dict[str, Any] = {}
    with writer:
        for number, (topic, time, make) in enumerate(written, start=1):
            message = make(store.types)
            kind_of = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind_of, typestore=store)
            pack = store.serialize_ros1 if is_ros1 else store.serialize_cdr
            writer.write(connections[topic], time, pack(message, kind_of))
            if kind == ".mcap" and number % 3 == 0:
                writer.storage.close_chunk()
    return folder / "drive.bag" if is_ros1 else folder / "drive" / f"drive{kind}"


def structured(count: int = 200, seed: int = 0) -> np.ndarray:
    """Return points in the fields of a Velodyne driver, with gaps between them."""
    from scans import make_scan

    scan = make_scan(count, seed)
    names = ["x", "y", "z", "intensity", "ring", "time"]
    layout = {
        "names": names,
        "formats": ["<f4", "<f4", "<f4", "<f4", "<u2", "<f4"],
        "offsets": [0, 4, 8, 16, 20, 24],
        "itemsize": 32,
    }
    points = np.zeros(count, layout)
    for name, values in zip("xyz", scan.points.T, strict=True):
        points[name] = values
    points["intensity"] = scan.intensity
    return points
