# SPDX-License-Identifier: MIT
"""Sizes that compressed points of a LAZ file promise, compared with the file.

lazrs believes them, and takes memory for so much before it reads.
"""

import struct
from collections.abc import Sequence
from typing import Any, BinaryIO

from salsanext_cli.files.reading import size_of

CHUNK_TABLE, CHUNK_COUNT = struct.Struct("<q"), struct.Struct("<4xI")
"""Offset of the table of chunks, before the first chunk or, if that is none, in the last bytes, and
the start of the table."""
ITEM, ITEMS_AT = struct.Struct("<HHH"), 34
"""Kind, size and version of an item of compressed points, and where the record has the first."""
LAYERS = {10: 9, 11: 1, 12: 2, 13: 1}
"""Layers of the kinds of items that have any: points, colours, colours with infrared, waves."""
EXTRA_BYTES = 14
"""Kind of item with a layer for each byte."""


def require_chunks(file: BinaryIO, offset: int, size: int) -> None:
    """Raise `ValueError` if the table of chunks is not in the file, or promises too many.

    lazrs would end the process where memory for so many cannot be had.
    """
    (table,) = CHUNK_TABLE.unpack(_bytes_at(file, offset, CHUNK_TABLE.size))
    if table <= offset:
        (table,) = CHUNK_TABLE.unpack(_bytes_at(file, size - CHUNK_TABLE.size, CHUNK_TABLE.size))
    (chunks,) = CHUNK_COUNT.unpack(_bytes_at(file, table, CHUNK_COUNT.size))
    if chunks > size:
        raise ValueError(f"{chunks} chunks of compressed points in {size} bytes")


def require_layers(file: BinaryIO, record: Any, offset: int, points: int) -> None:
    """Raise `ValueError` if the layers of compressed points go beyond the file.

    lazrs takes memory for each before it is read, up to 4 GB. A chunk has its first point as it is,
    the number of its points, the sizes of its layers in bytes, and these.

    `file`: its position stays; `offset`: byte where the points begin; `points`: their number.
    """
    items = ITEM.iter_unpack(bytes(record.record_data())[ITEMS_AT:])
    layers = sum(size if kind == EXTRA_BYTES else LAYERS.get(kind, 0) for kind, size, _ in items)
    if not layers:
        return
    before, at, sizes = file.tell(), offset + CHUNK_TABLE.size, struct.Struct(f"<4x{layers}I")
    for _ in _chunks(file, record, offset, points):
        at += record.item_size()
        at += sizes.size + sum(sizes.unpack(_bytes_at(file, at, sizes.size)))
        if at > size_of(file):
            raise ValueError("the layers of its points are longer than the file")
    file.seek(before)


def _chunks(file: BinaryIO, record: Any, offset: int, points: int) -> Sequence[object]:
    """Return an item for each chunk that lazrs reads: as many as hold the points."""
    if not record.uses_variable_size_chunks():
        return range(0, points, record.chunk_size())
    import lazrs

    file.seek(offset)
    counts = [count for count, _ in lazrs.read_chunk_table(file, record) if count]
    if sum(counts) < points:
        raise ValueError(f"chunks of {sum(counts)} of its {points} points")
    return counts


def _bytes_at(file: BinaryIO, offset: int, count: int) -> bytes:
    if not 0 <= offset <= size_of(file) - count:
        raise ValueError(f"it has no byte {offset}")
    file.seek(offset)
    return file.read(count)
