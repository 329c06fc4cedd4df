# SPDX-License-Identifier: MIT
"""ROS bags, read without ROS: ROS 1 `.bag`, ROS 2 `.mcap`, `.db3` and folders of these."""

import struct
import weakref
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from itertools import chain, islice
from pathlib import Path
from threading import Lock
from typing import Any

from salsanext_cli.errors import FormatError, error_text, first_few
from salsanext_cli.files.optional_packages import require_rosbags
from salsanext_cli.files.reading import filled, reading
from salsanext_cli.formats.columns import Columns
from salsanext_cli.formats.recordings.address import METADATA, files_of, storages
from salsanext_cli.formats.recordings.point_cloud2 import POINT_CLOUD2, columns_of

MAX_METADATA_BYTES = 4 << 20
DAMAGED = (
    *(struct.error, ValueError, LookupError, TypeError, AttributeError, AssertionError),
    *(ArithmeticError, MemoryError, EOFError, RuntimeError, OSError),
)
"""Built-in errors of the library where a bag is damaged."""


class Bag:
    """ROS bag, a `Recording` whose topics are those of ROS."""

    def __init__(self, path: Path) -> None:
        require_rosbags()
        self.path, self.lost, self._lock = path, "", Lock()
        self._is_ros1 = path.suffix.lower() == ".bag" and not path.is_dir()
        self._types = _types_of_ros(1 if self._is_ros1 else 2)
        self._known: set[Any] = set()
        for file in files_of(path):
            # The library would wait at a pipe, and does not say what the system refuses.
            with reading(file) as opened:
                text = opened.read(MAX_METADATA_BYTES + 1) if file.name == METADATA else b""
            # A few lines with merges of merges would keep the library busy for days.
            if len(text) > MAX_METADATA_BYTES or b"<<" in text:
                raise FormatError(file, "not as ROS writes it", "the metadata of a ROS 2 bag")
        self._storages = self._opened()
        for storage in self._storages:
            # Before the garbage collector would do it, with a warning.
            weakref.finalize(self, storage.close)
        logs = [file.with_name(f"{file.name}-wal") for file in files_of(path)]
        if left := [log.name for log in logs if filled(log)]:
            # SQLite moves them into the database when it is opened for writing.
            self.lost = f"lacks what its recorder left in {first_few(left)}, until sqlite3 opens it"

    def _opened(self) -> list[Any]:
        from salsanext_cli.formats.recordings.bag_storages import whole_storage

        try:
            with _refusing(self.path):
                return [whole_storage(self.path)]
        except FormatError as error:
            files = storages(self.path) if self.path.is_dir() else [self.path]
            found, cut = self._opened_one_by_one(files)
            if cut and any(each.msgcount for part in found for each in part.connections):
                return found
            for part in found:
                part.close()
            if not cut:
                remedy = f"give {files[0]} itself"
                expected = "the metadata of a ROS 2 bag"
                raise FormatError(self.path / METADATA, error.found, expected, remedy) from error
            raise error

    def _opened_one_by_one(self, files: list[Path]) -> tuple[list[Any], bool]:
        """Open what is whole of each file; say whether any is not as its recorder leaves it."""
        from salsanext_cli.formats.recordings.bag_storages import whole_storage
        from salsanext_cli.formats.recordings.cut_storages import cut_storage

        found, cut, lost = [], False, []
        for file in files:
            try:
                with _refusing(file):
                    found.append(whole_storage(file))
            except FormatError:
                cut = True
                lost.append(file.name)
                with suppress(FormatError), _refusing(file):
                    found.append(cut_storage(file))
                    if found[-1].whole:
                        lost.pop()
        self.lost = f"{first_few(lost)}: cut off or damaged" if lost else ""
        return found, cut

    def topics(self) -> dict[str, str]:
        """Return the type of the messages of every topic that has some, sorted."""
        found = chain.from_iterable(storage.connections for storage in self._storages)
        return {
            each.topic: each.msgtype
            for each in sorted(found, key=lambda each: each.topic)
            if each.msgcount
        }

    def clouds(self) -> list[str]:
        """Return the topics of point clouds."""
        return [topic for topic, kind in self.topics().items() if kind == POINT_CLOUD2]

    def times(self, topic: str) -> list[int]:
        """Return the times of the clouds of a topic in nanoseconds, sorted.

        They are those of recording, since others would have to be read from the clouds.
        """
        from salsanext_cli.formats.recordings.bag_storages import times_of

        with self._lock, _refusing(self.path):
            times = (times_of(each, topic, POINT_CLOUD2) for each in self._storages)
            return sorted(chain.from_iterable(times))

    def columns(self, topic: str, time: int, number: int, path: Path) -> Columns:
        """Read the cloud of a topic and a time; of several of one time that of a number."""
        with _refusing(path):
            with self._lock:
                found = next(islice(self._messages(topic, time), number, None), None)
            if found is None:
                raise FormatError(path, "not there", "a cloud that the bag lists")
            connection, raw = found
            self._require_known(connection, path)
            read = self._types.deserialize_ros1 if self._is_ros1 else self._types.deserialize_cdr
            return columns_of(read(raw, POINT_CLOUD2), path)

    def _messages(self, topic: str, time: int) -> Iterator[tuple[Any, bytes]]:
        for storage in self._storages:
            of_topic = [each for each in storage.connections if each.topic == topic]
            wanted = [each for each in of_topic if each.msgtype == POINT_CLOUD2]
            for connection, _, raw in storage.messages(wanted, time, time + 1) if wanted else ():
                yield connection, raw

    def _require_known(self, connection: Any, path: Path) -> None:
        """Refuse a bag that defines the messages otherwise than ROS; without any, ROS' counts.

        Its own definitions are not used: the library would generate code from them.
        """
        from rosbags.interfaces import MessageDefinitionFormat as Format
        from rosbags.typesys import get_types_from_idl, get_types_from_msg

        definition = connection.msgdef
        if definition in self._known or definition.format == Format.NONE:
            return
        if definition.format == Format.MSG:
            defined = get_types_from_msg(definition.data, POINT_CLOUD2)
        else:
            parts = [part for part in definition.data.split(f"{'=' * 80}\n") if part.strip()]
            defined = {}
            for part in parts:
                text = part.split("\n", 1)[1] if part.startswith("IDL: ") else part
                defined |= get_types_from_idl(text)
        for name in {*defined, POINT_CLOUD2} & {*self._types.fielddefs}:
            if defined.get(name, (None, None))[1] != self._types.fielddefs[name][1]:
                found = f"defines {name} otherwise than ROS"
                raise FormatError(path, found, "its own definition", "record the bag anew")
        self._known.add(definition)


@cache
def _types_of_ros(version: int) -> Any:
    """Return ROS' own definitions of its messages; those of clouds are the same in all releases."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS1_NOETIC if version == 1 else Stores.ROS2_JAZZY)


@contextmanager
def _refusing(path: Path) -> Iterator[None]:
    """Turn the errors of the library into a `FormatError`."""
    import apsw
    from rosbags import rosbag1, rosbag2
    from rosbags.rosbag2.reader import zstd
    from rosbags.serde import SerdeError
    from rosbags.typesys import TypesysError

    own = (rosbag1.ReaderError, rosbag2.ReaderError, SerdeError, TypesysError)
    try:
        yield
    except (*own, zstd.ZstdError, apsw.Error, *DAMAGED) as error:
        remedy = "record it anew, or try `rosbag reindex` or `ros2 bag reindex`"
        raise FormatError(path, f"damaged: {error_text(error)}", "a ROS bag", remedy) from error
