# SPDX-License-Identifier: MIT
"""Header and schemas of MCAP files, to name recordings that are not of ROS 2."""

import struct
from collections.abc import Iterator
from io import BufferedReader
from pathlib import Path

from salsanext_cli.core.errors import FormatError
from salsanext_cli.core.texts import first_few
from salsanext_cli.io.files.reading import reading, size_of

MAGIC = b"\x89MCAP0\r\n"
HEADER = 0x01
FOOTER = 0x02
SCHEMA = 0x03
RECORD = struct.Struct("<BQ")  # Kind and number of bytes of a record
TEXT = struct.Struct("<I")  # Number of bytes of a text
FOOTER_BYTES = 20
TAIL_BYTES = RECORD.size + FOOTER_BYTES + len(MAGIC)
MAX_SUMMARY_BYTES = 1 << 26
ROS1 = "ros1"
ROS2 = "ros2"
EXPECTED = "a recording of ROS 2"
ROS1_HINT = "give the .bag file that it was converted from"
OTHER_HINT = (
    "write each cloud to .npy, with columns x, y, z, intensity: the package `mcap` reads it"
)


def require_ros2(path: Path) -> None:
    """Raise `FormatError` with the content of an MCAP file that was not written by ROS 2.

    A file without a readable header passes: its reader says what is wrong.
    """
    with reading(path) as file:
        profile = _profile(file)
        if profile in (None, ROS2):
            return
        schemas = sorted(set(_schemas(file)))
    if profile == ROS1:
        raise FormatError(path, "is a recording of ROS 1 in an MCAP file", EXPECTED, ROS1_HINT)
    content = f"contains {first_few(schemas)}" if schemas else f"has the profile {profile!r}"
    raise FormatError(path, f"is not a recording of ROS 2: {content}", EXPECTED, OTHER_HINT)


def _profile(file: BufferedReader) -> str | None:
    """Return the profile in the header of a file; None without a readable header."""
    start = file.read(len(MAGIC) + RECORD.size)
    if len(start) < len(MAGIC) + RECORD.size or not start.startswith(MAGIC):
        return None
    kind, size = RECORD.unpack_from(start, len(MAGIC))
    if kind != HEADER or size > size_of(file):
        return None
    return _text(file.read(size), 0)


def _text(record: bytes, offset: int) -> str | None:
    """Return the text at an offset of a record; None if the record ends within it."""
    begin = offset + TEXT.size
    if len(record) < begin:
        return None
    (length,) = TEXT.unpack_from(record, offset)
    text = record[begin : begin + length]
    return text.decode(errors="replace") if len(text) == length else None


def _schemas(file: BufferedReader) -> Iterator[str]:
    """Yield the names of the message types in the summary at the end of a file."""
    end = size_of(file) - TAIL_BYTES
    if end < 0:
        return
    file.seek(end)
    tail = file.read()
    kind, size = RECORD.unpack_from(tail)
    (start,) = struct.unpack_from("<Q", tail, RECORD.size)
    if (kind, size) != (FOOTER, FOOTER_BYTES) or not 0 < start <= end < start + MAX_SUMMARY_BYTES:
        return
    file.seek(start)
    summary = file.read(end - start)
    place = 0
    while place + RECORD.size <= len(summary):
        kind, size = RECORD.unpack_from(summary, place)
        place += RECORD.size
        name = _text(summary[place : place + size], 2) if kind == SCHEMA else None
        if name:
            yield name
        place += size
