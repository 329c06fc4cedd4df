# SPDX-License-Identifier: MIT
"""Storages of ROS bags that were cut off or never closed: what is whole of them."""

from __future__ import annotations

import struct
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import Any

import apsw
from rosbags.interfaces import (
    Connection,
    ConnectionExtRosbag2,
    MessageDefinition,
    MessageDefinitionFormat,
)
from rosbags.rosbag1.reader import Header, Reader, ReaderError, RecordType
from rosbags.rosbag2.storage_mcap import McapReader
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader, make_vfs

from salsanext_cli.formats.recordings.bounded_file import BoundedPath

MCAP_MAGIC = b"\x89MCAP0\r\n"
MCAP_FOOTER = b"\x02" + struct.pack("<QQQI", 20, 0, 0, 0) + MCAP_MAGIC
"""End of an MCAP file without a summary."""
MCAP_DATA_END, MCAP_FOOTER_RECORD = 0x0F, 0x02


class UnindexedBag(Reader):
    """ROS 1 bag without its index, which its recorder writes last: chunk after chunk is looked for.

    `whole`: whether nothing but the index is missing.
    """

    whole = False

    def open(self) -> None:
        """Read the index records that follow each chunk, and no chunk but those of connections."""
        bio: Any = self.path.open("rb")
        self.bio, size, start = bio, bio.size, 0
        bio.readline()
        indexes: dict[int, list[Any]] = defaultdict(list)
        with suppress(ReaderError, struct.error, IndexError, AssertionError):
            Header.read(bio, RecordType.BAGHEADER)
            self._skip(bio)
            while (place := bio.tell()) < size:
                op = Header.read(bio).get_uint8("op")
                bio.seek(place)
                if op == RecordType.CHUNK:
                    chunk, start = self.read_chunk(), place
                    if bio.tell() > size:
                        break
                    self.chunks[start] = chunk
                elif op == RecordType.IDXDATA:
                    self.read_index_data(start, indexes)
                else:
                    break
            self.whole = bio.tell() == size
        self.connections: list[Any] = self._found_connections(indexes)
        self.indexes = {found.id: sorted(indexes[found.id]) for found in self.connections}
        self.connections = [
            each._replace(msgcount=len(self.indexes[each.id])) for each in self.connections
        ]

    def _found_connections(self, indexes: dict[int, list[Any]]) -> list[Any]:
        """Read the record of each connection from the chunk of its first message."""
        bio, connections = self.bio, dict[int, Any]()
        for start in sorted(
            {min(entry.chunk_pos for entry in index) for index in indexes.values()}
        ):
            chunk = self.chunks[start]
            bio.seek(chunk.datapos)
            self.bio = records = BytesIO(chunk.decompressor(bio.read(chunk.datasize)))
            while (place := records.tell()) < len(records.getbuffer()):
                if Header.read(records).get_uint8("op") == RecordType.CONNECTION:
                    records.seek(place)
                    found = self.read_connection()
                    connections.setdefault(found.id, found)
                else:
                    self._skip(records)
        self.bio = bio
        return [*connections.values()]

    @staticmethod
    def _skip(records: Any) -> None:
        """Skip the data of a record."""
        (size,) = struct.unpack("<L", records.read(4))
        records.seek(size, 1)


class CutMcap(McapReader):
    """MCAP file without its end: the whole records before it."""

    whole = False

    def __init__(self, path: Path) -> None:
        with BoundedPath(path).open("rb") as file:
            place = file.seek(len(MCAP_MAGIC))
            while len(head := file.read(9)) == 9:
                op, size = struct.unpack("<BQ", head)
                if op in (MCAP_DATA_END, MCAP_FOOTER_RECORD) or place + 9 + size > file.size:
                    break
                place = file.seek(place + 9 + size)
        super().__init__(BoundedPath(path, place, MCAP_FOOTER))


class CutDatabase(Sqlite3Reader):
    """SQLite storage without its end: the rows before the first that lacks a page."""

    whole = False

    def open(self) -> None:
        """Open the whole pages and list the topics."""
        # SQLite would fill a page that was cut with zeros.
        size, page = page_sizes(Path(str(self.path)))
        self.vfs = make_vfs(BoundedPath(Path(str(self.path)), size // page * page))
        self.dbconn = apsw.Connection(
            f"file:{self.path}?immutable=1",
            flags=apsw.SQLITE_OPEN_READONLY | apsw.SQLITE_OPEN_URI,
            vfs="rpathvfs",
        )
        # Otherwise it refuses a file that is shorter than its header says.
        self.dbconn.execute("PRAGMA writable_schema=ON")
        undefined = MessageDefinition(MessageDefinitionFormat.NONE, "")
        self.connections = [
            Connection(key, topic, kind, undefined, "", 0, ConnectionExtRosbag2("cdr", []), self)
            for key, topic, kind in self.dbconn.execute("SELECT id, name, type FROM topics")
        ]
        counts = Counter(connection.id for connection, _, _ in self.messages(self.connections))
        self.connections = [each._replace(msgcount=counts[each.id]) for each in self.connections]

    def messages(
        self, connections: Any, start: int | None = None, stop: int | None = None
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """Yield the whole messages, those of the time `start` if it is given."""
        by_key = {each.id: each for each in connections}
        # The index of times may lack pages that the rows have.
        query = "SELECT topic_id, timestamp, data FROM messages NOT INDEXED"
        assert self.dbconn
        with suppress(apsw.CorruptError):
            for key, time, data in self.dbconn.execute(query):
                if key in by_key and start in (None, time):
                    yield by_key[key], time, data


def page_sizes(path: Path) -> tuple[int, int]:
    """Return the size of a SQLite file and of its pages in bytes."""
    with path.open("rb") as file:
        head = file.read(18)
    page = int.from_bytes(head[16:18], "big")
    if head[:6] != b"SQLite" or (page != 1 and page < 512):
        raise ReaderError("no SQLite file")
    return path.stat().st_size, 65536 if page == 1 else page


def cut_storage(path: Path) -> Any:
    """Open what is whole of a storage file that was cut off or never closed."""
    makers: dict[str, Callable[[], Any]] = {
        ".bag": lambda: UnindexedBag(BoundedPath(path)),
        ".mcap": lambda: CutMcap(path),
        ".db3": lambda: CutDatabase(path),
    }
    storage = makers[path.suffix.lower()]()
    storage.open()
    return storage
