# SPDX-License-Identifier: MIT
"""ROS bags, read without ROS: ROS 1 `.bag`, ROS 2 `.mcap`, `.db3` and folders of them."""

import re
import weakref
from collections.abc import Collection
from contextlib import suppress
from itertools import islice
from operator import attrgetter
from pathlib import Path
from threading import Lock
from typing import Any

from salsanext_cli.core.errors import FormatError, NoInputError
from salsanext_cli.core.optional_packages import require_rosbags
from salsanext_cli.core.texts import shortened
from salsanext_cli.io.bag_index import message_times, storage_count
from salsanext_cli.io.files.reading import filled, reading, refusing_damage
from salsanext_cli.io.formats.columns import Columns
from salsanext_cli.io.formats.ros.cloud_messages import CLOUD_MESSAGES, default_types, point_count
from salsanext_cli.io.formats.ros.mcap import require_ros2

MCAP = ".mcap"
MAX_SHOWN = 500  # Characters of a list of topics in an error
PACKETS = re.compile("packet|(velodyne|rslidar|pandar)scan", re.IGNORECASE)  # Types of messages
PACKETS_HINT = "play the bag with the driver of the sensor, and record the clouds that it publishes"
EXPECTED = "a ROS bag"
HINT = "repair it with `rosbag reindex`, `ros2 bag reindex` or `mcap recover`"


class Bag:
    """ROS bag, read by `rosbags`; threads may share it."""

    def __init__(self, path: Path, files: list[Path]) -> None:
        require_rosbags()
        from rosbags.highlevel import AnyReader

        self.path = path
        self.is_mcap = any(MCAP in file.suffixes for file in files)
        self._lock = Lock()
        for file in files:
            # The library would block at a pipe and hide the errors of the system.
            with reading(file):
                log = file.with_name(f"{file.name}-wal")
            if filled(log):
                problem = "is not yet in the database"
                hint = f"open {file.name} with sqlite3 once"
                raise FormatError(log, problem, "a closed bag", hint)
            if file.suffix.lower() == MCAP:
                require_ros2(file)
        with refusing_damage(path, EXPECTED, HINT):
            self.reader = AnyReader([path], default_typestore=default_types())
            self.reader.open()
            # The garbage collector would close it with a warning.
            weakref.finalize(self, self.reader.close)
            # Metadata that names a storage twice yields its clouds twice.
            if storage_count(self.reader) >= len(files):
                raise ValueError("its metadata names more files than there are")

    def topics(self) -> dict[str, str]:
        """Return the message type of every topic with messages, sorted."""
        connections = sorted(self.reader.connections, key=attrgetter("topic"))
        return {c.topic: c.msgtype for c in connections if c.msgcount}

    def cloud_topics(self) -> list[str]:
        """Return the topics with point clouds, sorted."""
        return [topic for topic, kind in self.topics().items() if kind in CLOUD_MESSAGES]

    def other_points(self, topics: Collection[str]) -> list[str]:
        """Return the topics with points or packets of a sensor that are none of some topics."""
        others = {topic: kind for topic, kind in self.topics().items() if topic not in topics}
        return [
            topic
            for topic, kind in others.items()
            if PACKETS.search(kind) or (kind in CLOUD_MESSAGES and self.point_count(topic))
        ]

    def without_clouds(self) -> NoInputError:
        """Return the error of a bag without point clouds, with its topics."""
        kinds = self.topics()
        topics = ", ".join(f"{topic} ({kind})" for topic, kind in kinds.items())
        problem = f"has no point clouds, but {shortened(topics, MAX_SHOWN)}"
        hint = PACKETS_HINT if any(map(PACKETS.search, kinds.values())) else ""
        expected = "clouds, such as sensor_msgs/PointCloud2"
        return NoInputError(self.path, problem if topics else "has no messages", expected, hint)

    def scan_keys(self, topic: str) -> list[int]:
        """Return the recording times of the clouds of a topic in nanoseconds, sorted."""
        with self._lock, refusing_damage(self.path, EXPECTED, HINT):
            return sorted(
                message_times(self.reader, lambda connection: is_cloud(connection, topic))
            )

    def point_count(self, topic: str) -> int:
        """Return the largest number of points in the first, middle and last cloud of a topic."""
        times = self.scan_keys(topic)
        if not times:
            return 0
        sample = sorted({times[0], times[len(times) // 2], times[-1]})
        counts = [0]
        for time in sample:
            # A damaged cloud is reported when it is labelled.
            with suppress(FormatError):
                message, _ = self._message(topic, time, 0, self.path)
                counts.append(point_count(message))
        return max(counts)

    def poses(self) -> None:
        """Return None: bags are read for their clouds only."""

    def columns(self, topic: str, key: int, number: int, path: Path) -> Columns:
        """Read the cloud of a topic and a time.

        Parameters
        ----------
        topic : str
            Topic of point clouds.
        key : int
            Recording time in nanoseconds.
        number : int
            Number of the cloud among those of the same time, from 0.
        path : Path
            Path of the scan, for errors.

        Returns
        -------
        Columns
            Values (N,) of each field, by name.

        Raises
        ------
        FormatError
            If there is no such cloud, or it is damaged.
        """
        message, kind = self._message(topic, key, number, path)
        return CLOUD_MESSAGES[kind](message, path)

    def _message(self, topic: str, time: int, number: int, path: Path) -> tuple[Any, str]:
        """Return the message of a topic and a time, and its type; `path` is for errors."""
        clouds = [c for c in self.reader.connections if is_cloud(c, topic)]
        with refusing_damage(path, EXPECTED, HINT):
            with self._lock:
                messages = self.reader.messages(clouds, time, time + 1)
                recorded = next(islice(messages, number, None), None)
            if recorded is None:
                raise FormatError(path, "no such cloud", "a cloud that the bag lists")
            connection, _, raw = recorded
            return self.reader.deserialize(raw, connection.msgtype), connection.msgtype


def is_cloud(connection: Any, topic: str) -> bool:
    """Return whether a connection has clouds of a topic."""
    return connection.topic == topic and connection.msgtype in CLOUD_MESSAGES
