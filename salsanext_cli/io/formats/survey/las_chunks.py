# SPDX-License-Identifier: MIT
"""Sizes that the compressed points of a LAZ file state, checked before lazrs allocates them."""

import struct
from collections.abc import Iterator
from typing import Any, BinaryIO

NO_OFFSET_OF_TABLE = -1
"""Offset of the table of chunks that a writer of a stream put at the end of the file."""
OFFSET = struct.Struct("<q")
COUNT = struct.Struct("<I")
LAYERED = 3  # Compressor of point formats 6 to 10, which compresses groups of fields apart
COMPRESSOR = struct.Struct("<H")
ITEMS = struct.Struct("<32xH")
"""Number of items of a point, in the record of the compression."""
ITEM = struct.Struct("<HHH")
"""Type, bytes and version of an item."""
LAYERS_OF_ITEM = {10: 9, 11: 1, 12: 2, 13: 1}
"""Layers of the fields of a point, of colours, of colours and infrared, and of a waveform."""
EXTRA_BYTES = 14  # Item with one layer for each of its bytes


def require_chunk_sizes(file: BinaryIO, header: Any, size: int) -> None:
    """Refuse stated sizes above that of the file, for which lazrs ends the process or allocates.

    Parameters
    ----------
    file : BinaryIO
        The open LAZ file, whose position changes.
    header : laspy.LasHeader
        Its header.
    size : int
        Its bytes.

    Raises
    ------
    ValueError
        If the table of chunks or a chunk states more than the file contains.
    """
    import lazrs

    offset = int(header.offset_to_point_data)
    _require_table(file, offset, size)
    record = header.vlrs[header.vlrs.index("LasZipVlr")].record_data
    (compressor,) = COMPRESSOR.unpack_from(record)
    if compressor != LAYERED:
        return
    file.seek(offset)
    chunks = lazrs.read_chunk_table(file, lazrs.LazVlr(record))
    sizes_of_layers = struct.Struct(f"<{_layers(record)}I")
    start = file.tell()
    if sum(points for points, _ in chunks) < header.point_count:
        raise ValueError("its chunks contain fewer points than its header states")
    if start + sum(chunk_bytes for _, chunk_bytes in chunks) > size:
        raise ValueError("its table of chunks states more bytes than it contains")
    for _, chunk_bytes in chunks:
        # A chunk is the first point, the number of points, and the sizes of layers before these.
        file.seek(start + header.point_format.size + COUNT.size)
        sizes = sizes_of_layers.unpack(file.read(sizes_of_layers.size))
        if sum(sizes) > chunk_bytes:
            raise ValueError("a chunk of its points states more bytes than it contains")
        start += chunk_bytes


def _require_table(file: BinaryIO, offset: int, size: int) -> None:
    """Refuse a table of chunks outside the file, or of more chunks than the file has bytes."""
    file.seek(offset)
    (table,) = OFFSET.unpack(file.read(OFFSET.size))
    if table == NO_OFFSET_OF_TABLE:
        file.seek(size - OFFSET.size)
        (table,) = OFFSET.unpack(file.read(OFFSET.size))
    if not offset < table <= size - OFFSET.size:
        raise ValueError("its table of chunks is outside the file")
    file.seek(table + COUNT.size)
    (chunks,) = COUNT.unpack(file.read(COUNT.size))
    if chunks > size:
        raise ValueError("it states more chunks than it contains")


def _layers(record: bytes) -> int:
    """Return the number of layers of a chunk."""
    return sum(
        item_bytes if kind == EXTRA_BYTES else LAYERS_OF_ITEM.get(kind, 0)
        for kind, item_bytes in _items(record)
    )


def _items(record: bytes) -> Iterator[tuple[int, int]]:
    """Yield the type and the bytes of each item of a point."""
    (count,) = ITEMS.unpack_from(record)
    for number in range(count):
        kind, item_bytes, _ = ITEM.unpack_from(record, ITEMS.size + number * ITEM.size)
        yield kind, item_bytes
