# SPDX-License-Identifier: MIT
"""ROS bags, read without ROS: ROS 1 `.bag`, ROS 2 `.mcap`, `.db3` and folders of them."""

import struct
import weakref
from collections.abc import Iterator
from itertools import chain, islice
from operator import attrgetter
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from salsanext_cli.errors import FormatError
from salsanext_cli.files.optional_packages import require_rosbags
from salsanext_cli.files.reading import filled, reading, refusing_damage
from salsanext_cli.formats.columns import Columns

POINT_CLOUD2 = "sensor_msgs/msg/PointCloud2"
TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""NumPy's names of the types of a field."""
INDEX_ENTRY = struct.Struct("<QQ")  # Time and offset of a message, in the index of an MCAP chunk
EXPECTED = "a ROS bag"
HINT = "repair it with `rosbag reindex`, `ros2 bag reindex` or `mcap recover`"


def columns_of(message: Any, path: Path) -> Columns:
    """Return the values (N,) of each field of one value per point, as views into the message."""
    # The first of two fields of one name counts. Rows and points may be padded.
    height, width, step = message.height, message.width, message.point_step
    row_step = message.row_step if height > 1 else width * step
    order = ">" if message.is_bigendian else "<"
    with refusing_damage(path, EXPECTED, HINT):
        if row_step < width * step:
            raise ValueError(f"rows of {row_step} bytes for {width} points of {step}")
        size = (height - 1) * row_step + width * step if height and width else 0
        if len(message.data) < size:
            raise ValueError(f"{len(message.data)} bytes of data, not {size}")
        fields: dict[str, tuple[str, int]] = {}
        for field in message.fields:
            if field.count <= 1:  # Old drivers write 0.
                fields.setdefault(field.name, (order + TYPES[field.datatype], field.offset))
        point = np.dtype(
            {
                "names": [*fields],
                "formats": [kind for kind, _ in fields.values()],
                "offsets": [offset for _, offset in fields.values()],
                "itemsize": step,
            }
        )
        data = np.asarray(message.data, np.uint8)
        points = np.ndarray((height, width), point, data, 0, (row_step, step))
    return {name: points[name].ravel() for name in fields}


class Bag:
    """ROS bag, read by `rosbags`; threads may share it."""

    def __init__(self, path: Path, files: list[Path]) -> None:
        require_rosbags()
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore

        self.path, self._lock = path, Lock()
        for file in files:
            # The library would block at a pipe and hide the errors of the system.
            with reading(file):
                log = file.with_name(f"{file.name}-wal")
            if filled(log):
                problem, hint = "is not yet in the database", f"open {file.name} with sqlite3 once"
                raise FormatError(log, problem, "a closed bag", hint)
        with refusing_damage(path, EXPECTED, HINT):
            # Databases from before 2023 lack definitions; clouds have the same one in all releases.
            self.reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY))
            self.reader.open()
            # The garbage collector would close it with a warning.
            weakref.finalize(self, self.reader.close)
            # Metadata that names a storage twice yields its clouds twice.
            if len(getattr(self._storage(), "storages", ())) >= len(files):
                raise ValueError("its metadata names more files than there are")

    def _storage(self) -> Any:
        (reader,) = self.reader.readers
        return getattr(reader, "storage", reader)

    def topics(self) -> dict[str, str]:
        """Return the message type of every topic with messages, sorted."""
        connections = sorted(self.reader.connections, key=attrgetter("topic"))
        return {c.topic: c.msgtype for c in connections if c.msgcount}

    def times(self, topic: str) -> list[int]:
        """Return the recording times of the clouds of a topic in nanoseconds, sorted."""
        with self._lock, refusing_damage(self.path, EXPECTED, HINT):
            return sorted(_indexed_times(self._storage(), topic))

    def columns(self, topic: str, time: int, number: int, path: Path) -> Columns:
        """Read the cloud of a topic and a time; `number` counts clouds of the same time from 0."""
        clouds = _connections_of(self.reader, topic)
        with refusing_damage(path, EXPECTED, HINT):
            with self._lock:
                messages = self.reader.messages(clouds, time, time + 1)
                message = next(islice(messages, number, None), None)
            if message is None:
                raise FormatError(path, "no such cloud", "a cloud that the bag lists")
            connection, _, raw = message
            return columns_of(self.reader.deserialize(raw, connection.msgtype), path)


def _connections_of(reader: Any, topic: str) -> list[Any]:
    """Return the connections of a reader with clouds of a topic."""
    return [c for c in reader.connections if (c.topic, c.msgtype) == (topic, POINT_CLOUD2)]


def _indexed_times(storage: Any, topic: str) -> Iterator[int]:
    """Yield the times of the clouds of a topic in nanoseconds, unordered, from the indices."""
    wanted = _connections_of(storage, topic)
    keys = [connection.id for connection in wanted]
    if hasattr(storage, "storages"):  # a folder of files
        yield from chain.from_iterable(_indexed_times(part, topic) for part in storage.storages)
    elif hasattr(storage, "indexes"):  # ROS 1
        yield from (entry.time for key in keys for entry in storage.indexes[key])
    elif hasattr(storage, "dbconn"):  # SQLite
        marks = ",".join("?" * len(keys))
        query = f"SELECT timestamp FROM messages WHERE topic_id IN ({marks})"
        yield from (time for (time,) in storage.dbconn.execute(query, keys))
    elif storage.chunks:  # MCAP
        for chunk in storage.chunks:
            yield from chain.from_iterable(_times_of_chunk(storage, chunk, key) for key in keys)
    else:
        # A file without chunks has no index.
        yield from (time for _, time, _ in storage.messages_scan(wanted))


def _times_of_chunk(storage: Any, chunk: Any, key: int) -> Iterator[int]:
    """Yield the times of the messages of a channel from the index of an MCAP chunk."""
    if (offset := chunk.message_index_offsets.get(key)) is None:
        return
    storage.bio.seek(offset)
    op, _, channel, size = struct.unpack("<BQHI", storage.bio.read(15))
    if (op, channel) != (0x07, key):
        raise ValueError("the index of a chunk is misplaced")
    yield from (time for time, _ in INDEX_ENTRY.iter_unpack(storage.bio.read(size)))
