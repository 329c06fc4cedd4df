# SPDX-License-Identifier: MIT
"""Storages of ROS bags: rosbags' readers, and the times of messages in their indices.

A storage has `connections`, `messages(connections, start, stop)` and `close()`.
"""

from __future__ import annotations

import operator
import struct
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any

from rosbags.rosbag1.reader import Reader, ReaderError
from rosbags.rosbag2.reader import DirectoryReader
from rosbags.rosbag2.storage_mcap import McapReader
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

from salsanext_cli.formats.recordings.address import storages
from salsanext_cli.formats.recordings.bounded_file import BoundedPath
from salsanext_cli.formats.recordings.cut_storages import CutDatabase, page_sizes

INDEX_ENTRY = struct.Struct("<QQ")
"""Time and place of a message, in the index of an MCAP chunk."""


def whole_storage(path: Path) -> Any:
    """Open a storage with its index."""
    storage: Any
    for database in storages(path) if path.is_dir() else [path]:
        if database.suffix == ".db3" and operator.mod(*page_sizes(database)):
            # SQLite would fill up the last page with zeros.
            raise ReaderError(f"{database.name} ends within a page")
    if path.is_dir():
        storage = DirectoryReader(path)
    elif path.suffix.lower() == ".db3":
        storage = Sqlite3Reader(path)
    else:
        reader: Any = Reader if path.suffix.lower() == ".bag" else McapReader
        storage = reader(BoundedPath(path))
    storage.open()
    if path.is_dir():
        there = {file.name.removesuffix(".zstd") for file in storages(path)}
        listed = [part.path for part in storage.storages]
        if len(listed) != len(there) or len({*listed}) != len(there):
            storage.close()
            raise ReaderError(f"lists {len(listed)} files, where {len(there)} are")
    return storage


def times_of(storage: Any, topic: str, kind: str) -> Iterator[int]:
    """Yield the times of the messages of a topic in nanoseconds, unordered, from the indices."""
    wanted = [each for each in storage.connections if (each.topic, each.msgtype) == (topic, kind)]
    keys = [each.id for each in wanted]
    if isinstance(storage, DirectoryReader):
        yield from chain.from_iterable(times_of(each, topic, kind) for each in storage.storages)
    elif isinstance(storage, Reader):
        yield from (entry.time for key in keys for entry in storage.indexes[key])
    elif isinstance(storage, CutDatabase):
        yield from (time for _, time, _ in storage.messages(wanted))
    elif isinstance(storage, Sqlite3Reader):
        marks = ",".join("?" * len(keys))
        query = f"SELECT timestamp FROM messages WHERE topic_id IN ({marks})"
        assert storage.dbconn
        yield from (time for (time,) in storage.dbconn.execute(query, keys))
    elif storage.chunks:
        for chunk in storage.chunks:
            yield from chain.from_iterable(_indexed(storage, chunk, key) for key in keys)
    else:
        # A file without chunks has no index but the headers of its messages.
        yield from (time for _, time, _ in storage.messages_scan(wanted))


def _indexed(storage: Any, chunk: Any, key: int) -> Iterator[int]:
    """Yield the times in the index of an MCAP chunk of the messages of a channel."""
    if (place := chunk.message_index_offsets.get(key)) is None:
        return
    storage.bio.seek(place)
    op, _, channel, size = struct.unpack("<BQHI", storage.bio.read(15))
    if (op, channel) != (0x07, key):
        raise ReaderError("the index of a chunk is not where it should be")
    yield from (time for time, _ in INDEX_ENTRY.iter_unpack(storage.bio.read(size)))
