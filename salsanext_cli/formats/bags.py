# SPDX-License-Identifier: MIT
"""ROS bags, read without ROS: ROS 1 `.bag`, ROS 2 `.mcap`, `.db3` and folders of these."""

import struct
import weakref
from collections.abc import Iterator
from itertools import chain, islice
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
INDEX_ENTRY = struct.Struct("<QQ")  # Time and place of a message, in the index of an MCAP chunk
EXPECTED, REMEDY = "a ROS bag", "mend it by `rosbag reindex`, `ros2 bag reindex` or `mcap recover`"


def columns_of(message: Any, path: Path) -> Columns:
    """Return the values (N,) of each field of one value per point, as views into the message."""
    # Of two fields of one name, the first counts. Rows and points may be padded.
    height, width, step = message.height, message.width, message.point_step
    row_step = message.row_step if height > 1 else width * step
    order = ">" if message.is_bigendian else "<"
    with refusing_damage(path, EXPECTED, REMEDY):
        if row_step < width * step:
            raise ValueError(f"rows of {row_step} bytes for {width} points of {step}")
        promised = (height - 1) * row_step + width * step if height and width else 0
        if len(message.data) < promised:
            raise ValueError(f"{len(message.data)} bytes of data, not {promised}")
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
    # Without fields, points take no room, however many there are.
    return {name: points[name].ravel() for name in fields}


class Bag:
    """ROS bag, read by `rosbags`, by any number of threads."""

    def __init__(self, path: Path, files: list[Path]) -> None:
        require_rosbags()
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore

        self.path, self._lock = path, Lock()
        for file in files:
            # The library would wait at a pipe, and does not say what the system refuses.
            with reading(file):
                log = file.with_name(f"{file.name}-wal")
            if filled(log):
                found, expected = "what its recorder left is not in the database", "a closed bag"
                raise FormatError(log, found, expected, f"open {file.name} with sqlite3 once")
        with refusing_damage(path, EXPECTED, REMEDY):
            # Databases of before 2023 lack definitions; all releases have the same ones of clouds.
            self.reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY))
            self.reader.open()
            # Before the garbage collector would do it, with a warning.
            weakref.finalize(self, self.reader.close)
            # Metadata beside the storages that names one of them twice gives each cloud twice.
            if len(getattr(self._storage(), "storages", ())) >= len(files):
                raise ValueError("its metadata names more files than there are")

    def _storage(self) -> Any:
        (reader,) = self.reader.readers
        return getattr(reader, "storage", reader)

    def topics(self) -> dict[str, str]:
        """Return the type of the messages of every topic that has some, sorted."""
        connections = sorted(self.reader.connections, key=lambda each: each.topic)
        return {each.topic: each.msgtype for each in connections if each.msgcount}

    def clouds(self) -> list[str]:
        """Return the topics of point clouds."""
        return [topic for topic, kind in self.topics().items() if kind == POINT_CLOUD2]

    def times(self, topic: str) -> list[int]:
        """Return the times of recording of the clouds of a topic in nanoseconds, sorted."""
        with self._lock, refusing_damage(self.path, EXPECTED, REMEDY):
            return sorted(_indexed_times(self._storage(), topic))

    def columns(self, topic: str, time: int, number: int, path: Path) -> Columns:
        """Read the cloud of a topic and a time; of several of one time that of a number."""
        clouds = _connections_of(self.reader, topic)
        with refusing_damage(path, EXPECTED, REMEDY):
            with self._lock:
                messages = self.reader.messages(clouds, time, time + 1)
                message = next(islice(messages, number, None), None)
            if message is None:
                raise FormatError(path, "not there", "a cloud that the bag lists")
            connection, _, raw = message
            return columns_of(self.reader.deserialize(raw, connection.msgtype), path)


def _connections_of(reader: Any, topic: str) -> list[Any]:
    """Return the connections of a reader that have clouds of a topic."""
    return [c for c in reader.connections if (c.topic, c.msgtype) == (topic, POINT_CLOUD2)]


def _indexed_times(storage: Any, topic: str) -> Iterator[int]:
    """Yield the times of the clouds of a topic in nanoseconds, unordered, from the indices."""
    wanted = _connections_of(storage, topic)
    keys = [each.id for each in wanted]
    if hasattr(storage, "storages"):  # a folder of files
        yield from chain.from_iterable(_indexed_times(each, topic) for each in storage.storages)
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
        # A file without chunks has no index but the headers of its messages.
        yield from (time for _, time, _ in storage.messages_scan(wanted))


def _times_of_chunk(storage: Any, chunk: Any, key: int) -> Iterator[int]:
    """Yield the times in the index of an MCAP chunk of the messages of a channel."""
    if (place := chunk.message_index_offsets.get(key)) is None:
        return
    storage.bio.seek(place)
    op, _, channel, size = struct.unpack("<BQHI", storage.bio.read(15))
    if (op, channel) != (0x07, key):
        raise ValueError("the index of a chunk is not where it should be")
    yield from (time for time, _ in INDEX_ENTRY.iter_unpack(storage.bio.read(size)))
