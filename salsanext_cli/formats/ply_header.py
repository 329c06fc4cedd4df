# SPDX-License-Identifier: MIT
"""Header of a PLY file compared with the file's size; plyfile allocates whatever it promises."""

from __future__ import annotations

import re

START = re.compile(rb"ply(\r\n|\r|\n)")
"""First line, with the line end of the whole header."""
MAX_HEADER_BYTES = 1 << 20
SIZES = {
    **dict.fromkeys(("char", "int8", "uchar", "uint8"), 1),
    **dict.fromkeys(("short", "int16", "ushort", "uint16"), 2),
    **dict.fromkeys(("int", "int32", "uint", "uint32", "float", "float32"), 4),
    **dict.fromkeys(("double", "float64"), 8),
}
"""Bytes of each type in a binary file; other types are refused when they are read."""
MIN_ASCII_BYTES = 2
"""Bytes of a value in an ascii file: a digit and a blank or a line end."""


def require_room(content: bytes) -> None:
    """Raise `ValueError` if the elements of a PLY file cannot all be in it.

    Parameters
    ----------
    content : bytes
        The whole file. Other errors of its header are left to plyfile.
    """
    start = START.match(content)
    end = content.find(start[1] + b"end_header" + start[1], 0, MAX_HEADER_BYTES) if start else -1
    if start is None or end < 0:
        raise ValueError("no PLY header")
    text = content[start.end() : end].decode("ascii")
    # Split as plyfile does, so that both find the same elements.
    lines = [line.split() for line in text.split(start[1].decode())]
    ascii_file = ["format", "ascii"] in (words[:2] for words in lines)
    room = len(content) - end
    for count, row in _elements(lines, ascii_file):
        # A row without properties has no bytes, but takes time.
        room -= count * max(row, 1)
        if count < 0 or room < 0:
            raise ValueError("the header promises more than the file holds")


def _elements(lines: list[list[str]], ascii_file: bool) -> list[tuple[int, int]]:
    """Return the number of rows of each element, and the least number of bytes of a row."""
    elements: list[tuple[int, int]] = []
    for words in lines:
        if words[:1] == ["element"] and len(words) == 3:
            elements.append((int(words[2]), 0))
        elif words[:1] == ["property"] and len(words) > 1 and elements:
            count, row = elements[-1]
            # A list has at least its length.
            kind = words[2] if words[1] == "list" and len(words) > 2 else words[1]
            size = MIN_ASCII_BYTES if ascii_file else SIZES.get(kind, 1)
            elements[-1] = (count, row + size)
    return elements
