# SPDX-License-Identifier: MIT
"""Records of a LAS file about its coordinate system, in front of its points and behind them."""

import struct
from collections.abc import Iterator
from typing import Any, BinaryIO

AUTHORS = ("LASF_Projection", "liblas")
EXTENDED_HEADER = struct.Struct("<2x16sHQ32x")
"""Author, number, and size of the content of a record behind the points."""
MAX_CONTENT_BYTES = 1 << 20  # Of a coordinate system; other records may have gigabytes


def projection_records(file: BinaryIO, header: Any, size: int) -> dict[int, bytes]:
    """Return the contents of the records about the coordinate system by their numbers.

    Parameters
    ----------
    file : binary file
        The LAS file; its position changes.
    header : laspy.LasHeader
        Its header, with the records in front of the points.
    size : int
        Size of the file in bytes.

    Returns
    -------
    dict of int to bytes
        Records in front of the points precede those behind them.

    Raises
    ------
    ValueError
        If the header states more records than the file contains.
    """
    contents: dict[int, bytes] = {}
    for record in header.vlrs:
        if record.user_id in AUTHORS:
            contents.setdefault(record.record_id, record.record_data_bytes())
    for number, content in _extended_records(file, header, size):
        contents.setdefault(number, content)
    return contents


def _extended_records(file: BinaryIO, header: Any, size: int) -> Iterator[tuple[int, bytes]]:
    """Yield number and content of the records of `AUTHORS` behind the points."""
    position = header.start_of_first_evlr
    for _ in range(header.number_of_evlrs):
        file.seek(position)
        start = file.read(EXTENDED_HEADER.size)
        if len(start) < EXTENDED_HEADER.size:
            raise ValueError("its header states more records than it contains")
        name, number, length = EXTENDED_HEADER.unpack(start)
        position += EXTENDED_HEADER.size + length
        if position > size:
            raise ValueError("its header states more records than it contains")
        author = name.rstrip(b"\0").decode("ascii", "replace")
        if author in AUTHORS and length <= MAX_CONTENT_BYTES:
            yield number, file.read(length)
