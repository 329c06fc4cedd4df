# SPDX-License-Identifier: MIT
"""Times of the messages of a ROS bag without reading them, its compression and metadata.

This is the only module that uses the private interfaces of rosbags, whose versions `pyproject.toml`
therefore bounds from above.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from typing import Any

CHUNK_INDEX = struct.Struct("<BQHI")  # Kind and size of the record, channel, bytes of the entries
CHUNK_INDEX_KIND = 0x07
CHUNK_ENTRY = struct.Struct("<QQ")  # Time and offset of a message

IsWanted = Callable[[Any], bool]
"""Function of a connection of rosbags, such as ``connection.topic == "/points"``."""


def storage_count(reader: Any) -> int:
    """Return the number of files of a folder that a reader has opened; 0 for a single file.

    Parameters
    ----------
    reader : rosbags.highlevel.AnyReader
        Open reader of one bag.
    """
    return len(getattr(_storage(reader), "storages", ()))


def message_times(reader: Any, is_wanted: IsWanted) -> Iterator[int]:
    """Yield the times of messages in nanoseconds, in no order.

    Parameters
    ----------
    reader : rosbags.highlevel.AnyReader
        Open reader of one bag.
    is_wanted : callable
        Returns whether the messages of a connection count.

    Yields
    ------
    int
    """
    yield from _times(_storage(reader), is_wanted)


def compression_of(reader: Any) -> str:
    """Return how a bag is compressed, as the writers of rosbags name it; empty if it is not.

    Parameters
    ----------
    reader : rosbags.highlevel.AnyReader
        Open reader of one bag.

    Returns
    -------
    str
        ``BZ2`` or ``LZ4`` for ROS 1; ``FILE``, ``MESSAGE`` or, for the chunks of MCAP files,
        ``STORAGE`` for ROS 2.
    """
    storage = _storage(reader)
    if hasattr(storage, "indexes"):  # ROS 1
        from rosbags.rosbag1.reader import decompressors

        names = {decompressor: name.upper() for name, decompressor in decompressors.items()}
        used = {names[chunk.decompressor] for chunk in storage.chunks.values()} - {"NONE"}
        return min(used, default="")
    mode = storage.metadata.compression_mode
    if mode:
        return str(mode).upper()
    for file in getattr(storage, "storages", [storage]):
        if any(chunk.compression for chunk in getattr(file, "chunks", ())):
            return "STORAGE"
    return ""


def custom_data(reader: Any) -> dict[str, str]:
    """Return the texts that the metadata of a bag of ROS 2 has by names of the user."""
    return dict(_storage(reader).metadata.custom or {})


def _storage(reader: Any) -> Any:
    """Return the storage of a bag of ROS 2, or the reader of a bag of ROS 1."""
    (single,) = reader.readers
    return getattr(single, "storage", single)


def _times(storage: Any, is_wanted: IsWanted) -> Iterator[int]:
    connections = [connection for connection in storage.connections if is_wanted(connection)]
    keys = [connection.id for connection in connections]
    if hasattr(storage, "storages"):  # A folder of files
        for file in storage.storages:
            yield from _times(file, is_wanted)
    elif hasattr(storage, "indexes"):  # ROS 1
        for key in keys:
            yield from (entry.time for entry in storage.indexes[key])
    elif hasattr(storage, "dbconn"):  # SQLite
        yield from _times_of_database(storage.dbconn, keys)
    elif storage.chunks:  # MCAP
        for chunk in storage.chunks:
            for key in keys:
                yield from _times_of_chunk(storage, chunk, key)
    else:  # An MCAP file without chunks has no index.
        yield from (time for _, time, _ in storage.messages_scan(connections))


def _times_of_database(database: Any, keys: list[int]) -> Iterator[int]:
    """Yield the times of the messages of topics from an SQLite database."""
    marks = ",".join("?" for _ in keys)
    query = f"SELECT timestamp FROM messages WHERE topic_id IN ({marks})"
    yield from (time for (time,) in database.execute(query, keys))


def _times_of_chunk(storage: Any, chunk: Any, key: int) -> Iterator[int]:
    """Yield the times of the messages of a channel from the index of an MCAP chunk."""
    offset = chunk.message_index_offsets.get(key)
    if offset is None:
        return
    storage.bio.seek(offset)
    kind, _, channel, size = CHUNK_INDEX.unpack(storage.bio.read(CHUNK_INDEX.size))
    if kind != CHUNK_INDEX_KIND or channel != key:
        raise ValueError("the index of a chunk is misplaced")
    yield from (time for time, _ in CHUNK_ENTRY.iter_unpack(storage.bio.read(size)))
