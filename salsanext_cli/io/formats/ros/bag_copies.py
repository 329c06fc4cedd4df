# SPDX-License-Identifier: MIT
"""Copies of ROS bags with other clouds: all other messages are copied byte for byte."""

import errno
import logging
import sqlite3
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from salsanext_cli.core.errors import FormatError
from salsanext_cli.core.texts import with_hint
from salsanext_cli.io.bag_index import compression_of, custom_data
from salsanext_cli.io.files.reading import refusing_damage
from salsanext_cli.io.formats.recordings import scan_name
from salsanext_cli.io.formats.ros.bags import EXPECTED, HINT, Bag, is_cloud
from salsanext_cli.io.formats.ros.cloud_messages import POINT_CLOUD2

VERSION = 8  # Of bags of ROS 2: Humble and all later releases read it
Types = Mapping[str, Any]
"""Classes of messages by their type, such as ``sensor_msgs/msg/PointCloud2``."""

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class CloudChange:
    """New clouds of a topic of a bag.

    Attributes
    ----------
    topic : str
        Topic of the new clouds: that of the old ones, which are replaced, or a new one.
    new_message : callable
        Function from the path of a scan, its message and the classes of messages to the new
        message; None writes none. A message of a new topic is a PointCloud2.
    """

    topic: str
    new_message: Callable[[Path, Any, Types], Any]


def copy_bag(bag: Bag, target: Path, changes: Mapping[str, CloudChange]) -> int:
    """Copy a bag, with other clouds of some topics.

    Messages are in the order of their times. Topics, types, definitions, qualities of service,
    publishers and compression are those of the bag. A bag of ROS 2 becomes a folder.

    Parameters
    ----------
    bag : Bag
        Bag to copy.
    target : Path
        New file or folder, which must not exist.
    changes : mapping of str to CloudChange
        New clouds by the topic of the old ones.

    Returns
    -------
    int
        Number of clouds of these topics.

    Raises
    ------
    FormatError
        If the bag is damaged, or lacks the definition of the messages of a changed topic.
    OSError
        If the copy cannot be written.
    """
    try:
        with _writer(bag, target) as writer:
            return _BagCopy(bag, writer, changes, _standard_types(bag)).write()
    except sqlite3.Error as error:
        is_full = error.sqlite_errorcode == sqlite3.SQLITE_FULL
        raise OSError(errno.ENOSPC if is_full else errno.EIO, str(error)) from error


def _writer(bag: Bag, target: Path) -> Any:
    """Return the writer of rosbags for a copy of a bag, compressed as the bag is."""
    from rosbags import rosbag1, rosbag2

    compression = compression_of(bag.reader)
    writer: Any
    if not bag.reader.is2:
        writer = rosbag1.Writer(target)
        if compression:
            writer.set_compression(rosbag1.Writer.CompressionFormat[compression])
        return writer
    plugin = rosbag2.StoragePlugin.MCAP if bag.is_mcap else rosbag2.StoragePlugin.SQLITE3
    writer = rosbag2.Writer(target, version=VERSION, storage_plugin=plugin)
    if compression:
        mode = rosbag2.CompressionMode[compression]
        writer.set_compression(mode, rosbag2.CompressionFormat.ZSTD)
    for key, value in custom_data(bag.reader).items():
        writer.set_custom_data(key, value)
    return writer


def _standard_types(bag: Bag) -> Any:
    """Return the typestore of rosbags of a late release of ROS 1 or ROS 2, as the bag is."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_JAZZY if bag.reader.is2 else Stores.ROS1_NOETIC)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Recorded:
    """Message of a bag."""

    connection: Any  # Of rosbags
    time: int  # Nanoseconds
    content: bytes


@dataclass(slots=True)
class _BagCopy:
    """Copy of a bag that is being written."""

    bag: Bag
    writer: Any  # Of rosbags, open
    changes: Mapping[str, CloudChange]
    standard_types: Any  # Typestore of rosbags with the types of new topics
    # Connections of the copy; publishers that connected twice are one
    connections: dict[tuple[str, str, str], Any] = field(default_factory=dict)

    def write(self) -> int:
        """Write all messages; return the number of clouds of the changed topics."""
        reader = self.bag.reader
        for connection in reader.connections:
            self._add(connection, connection.topic, connection.msgtype, reader.typestore)
        clouds = Counter[tuple[str, int]]()
        for recorded in self._messages():
            topic = recorded.connection.topic
            change = self.changes.get(topic)
            if change is None or not is_cloud(recorded.connection, topic):
                self._copy_message(recorded)
                continue
            name = scan_name(recorded.time, clouds[topic, recorded.time])
            clouds[topic, recorded.time] += 1
            path = self.bag.path / topic.strip("/") / name
            if change.topic == topic:
                self._replace_cloud(recorded, path, change)
            else:
                self._copy_message(recorded)
                self._add_cloud(recorded, path, change)
        return clouds.total()

    def _copy_message(self, recorded: _Recorded) -> None:
        """Write a message as it is."""
        connection = recorded.connection
        copy = self.connections[self._key(connection, connection.topic, connection.msgtype)]
        self.writer.write(copy, recorded.time, recorded.content)

    def _replace_cloud(self, recorded: _Recorded, path: Path, change: CloudChange) -> None:
        """Write the new cloud of a scan, which has the type of the old one."""
        connection = recorded.connection
        copy = self.connections[self._key(connection, connection.topic, connection.msgtype)]
        store = self.bag.reader.typestore
        new = change.new_message(path, self._decoded(recorded, path), store.types)
        self._write_cloud(copy, recorded.time, new, connection.msgtype, store)

    def _add_cloud(self, recorded: _Recorded, path: Path, change: CloudChange) -> None:
        """Write the new cloud of a scan, a PointCloud2, to the new topic."""
        store = self.standard_types
        added = self._add(recorded.connection, change.topic, POINT_CLOUD2, store)
        new = change.new_message(path, self._decoded(recorded, path), store.types)
        self._write_cloud(added, recorded.time, new, POINT_CLOUD2, store)

    def _decoded(self, recorded: _Recorded, path: Path) -> Any:
        """Return the message of a scan; `path`: of the scan, for errors."""
        with refusing_damage(path, EXPECTED, HINT):
            return self.bag.reader.deserialize(recorded.content, recorded.connection.msgtype)

    def _write_cloud(self, connection: Any, time: int, new: Any, kind: str, store: Any) -> None:
        """Write a message of a type, encoded with a typestore; None writes none."""
        if new is None:
            return
        encode = store.serialize_cdr if self.bag.reader.is2 else store.serialize_ros1
        self.writer.write(connection, time, encode(new, kind))

    def _messages(self) -> Iterator[_Recorded]:
        """Yield all messages of the bag."""
        with refusing_damage(self.bag.path, EXPECTED, HINT):
            for connection, time, content in self.bag.reader.messages():
                yield _Recorded(connection=connection, time=time, content=content)

    def _key(self, connection: Any, topic: str, kind: str) -> tuple[str, str, str]:
        return topic, kind, repr(connection.ext)

    def _add(self, connection: Any, topic: str, kind: str, store: Any) -> Any:
        """Return the connection of the copy for a topic, which is added at its first call.

        The definition of its type is that of the bag, else that of a typestore of rosbags. A topic
        of ROS 2 that is only copied may lack it in both.
        """
        key = self._key(connection, topic, kind)
        if key in self.connections:
            return self.connections[key]
        is2 = self.bag.reader.is2
        definition = connection.msgdef.data
        digest = connection.digest
        if topic != connection.topic:
            definition = ""
            digest = ""
        if (not definition or not digest) and kind not in store.fielddefs:
            error = _without_definition(self.bag.path, topic, kind)
            if connection.topic in self.changes or not is2:
                raise error
            text = f"{self.bag.path}: {error.problem}, and neither has its copy"
            log.warning("%s", with_hint(text, error.hint))
            digest = _hash_of_no_fields(kind)
        elif not definition:
            definition = store.generate_msgdef(kind, ros_version=2 if is2 else 1)[0]
        if not digest:
            digest = store.hash_rihs01(kind) if is2 else store.generate_msgdef(kind)[1]
        digest_name = "rihs01" if is2 else "md5sum"
        self.connections[key] = self.writer.add_connection(
            topic, kind, msgdef=definition, **{digest_name: digest}, **connection.ext._asdict()
        )
        return self.connections[key]


def _hash_of_no_fields(kind: str) -> str:
    """Return the hash of a type with an empty definition, with which rosbags compares it."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg("", kind))
    return store.hash_rihs01(kind)


def _without_definition(path: Path, topic: str, kind: str) -> FormatError:
    """Return the error of a bag of ROS 2 before Iron with a type that rosbags does not have."""
    problem = f"has no definition of {kind}, the type of {topic}"
    expected = "a bag with the definitions of all its messages"
    hint = (
        "write it again with `ros2 bag convert` of ROS 2 Iron or later, where the package "
        f"{kind.partition('/')[0]} is installed"
    )
    return FormatError(path, problem, expected, hint)
