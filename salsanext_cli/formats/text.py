# SPDX-License-Identifier: MIT
"""Scans as text: a point per line, its values separated by commas, semicolons or blanks."""

import io
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from salsanext_cli.errors import FormatError, notice_once, shortened
from salsanext_cli.files.reading import reading
from salsanext_cli.formats.columns import USED_NAMES, Columns, columns_of_width
from salsanext_cli.formats.kitti import CONTROL, TEXT_BYTES
from salsanext_cli.records import Double

BYTE_ORDER_MARK = b"\xef\xbb\xbf"
COMMENT_MARKS = ("#", "//")
MAX_HEADER_BYTES = 1 << 16
AXES = {
    f"{name}:{place}": "xyz"[place] for name in ("points_m_xyz", "points") for place in range(3)
}
"""Axes by the names of their columns, in lower case, in files of VeloView and ParaView."""
EXPECTED = "a point per line, with the same number of columns"
DECIMAL_COMMA = re.compile(rb'(?:^|[;\s"])-?\d*,\d+(?:[;\s"]|$)')
"""Number with a comma between blanks or semicolons, which separate the columns."""


@dataclass(frozen=True, slots=True)
class Layout:
    """Layout of a table of text."""

    start: int  # Offset of the first point in bytes
    delimiter: str | None  # Character between values; None for blanks
    width: int  # Number of columns
    names: tuple[str, ...]  # Names of the columns in lower case; empty if the file has none
    count: int | None = None  # Number of points, if the first line consists of it


def text_columns(path: Path, names: tuple[str, ...]) -> Columns:
    """Read coordinates and intensity from text; without a header the columns are `names`."""
    with reading(path) as file:
        content = file.read().removeprefix(BYTE_ORDER_MARK)
    if CONTROL.search(content[:TEXT_BYTES]):
        raise FormatError(path, "is not text", "a point per line, in ASCII or UTF-8")
    try:
        layout = layout_of(content, has_names=bool(names))
        if layout.names and names and layout.names != names:
            notice_once("--columns is ignored for files whose first line names the columns")
        names = layout.names or columns_of_width(layout.width, names, path)
        used = {name: i for i, name in enumerate(names) if name in USED_NAMES}
        if len(used) < sum(name in USED_NAMES for name in names):
            raise ValueError(f"repeats a column in {shortened(', '.join(names))}")
        if not {"x", "y", "z"} & set(used):
            raise ValueError(f"has columns {shortened(', '.join(names))}")
        table = _numbers(content, layout, tuple(used.values()))
        if layout.count not in (None, len(table)):
            raise ValueError(f"has {len(table)} of the {layout.count} points in its first line")
    except ValueError as error:
        require_decimal_points(content, path)
        raise FormatError(path, shortened(str(error)), EXPECTED) from error
    return dict(zip(used, table.T, strict=True))


def require_decimal_points(content: bytes, path: Path) -> None:
    """Refuse text with a decimal comma."""
    if match := DECIMAL_COMMA.search(content):
        number = match[0].strip(b'; \t\r\n"').decode()
        hint = "rewrite the file with decimal points"
        raise FormatError(path, f"has decimal commas: {number}", "decimal points", hint)


def layout_of(content: bytes, has_names: bool) -> Layout:
    """Return the layout from the first point, after a header or a number and further text."""
    at, names, count = 0, tuple[str, ...](), None
    while at < min(len(content), MAX_HEADER_BYTES):
        end = content.find(b"\n", at) + 1 or len(content)
        line = content[at:end].decode("latin-1").strip()
        delimiter = next((mark for mark in ";," if mark in line), None)
        words = _words(line, delimiter)
        if line.startswith(COMMENT_MARKS):
            named = _words(line.lstrip("#/"), delimiter)
            names = named if {"x", "y", "z"} <= set(named) else names
        elif count is None and len(words) == 1 and words[0].isdecimal():
            count = int(words[0])
        elif (any if count is None else all)(map(is_number, words)):
            # A comment is a header only if it fits.
            fitting = names if len(names) == len(words) else ()
            return Layout(at, delimiter, len(words), fitting, count)
        elif {"x", "y", "z"} <= set(words):
            return Layout(end, delimiter, len(words), words, count)
        elif line and count is None:
            if not has_names:
                raise ValueError(f"has {shortened(line)} instead of numbers or names x, y, z")
            return Layout(end, delimiter, len(words), (), count)
        at = end
    raise ValueError("has no points")


def _words(line: str, delimiter: str | None) -> tuple[str, ...]:
    """Return the fields of a line, in lower case, without surrounding blanks and quotes."""
    words = [word.strip(' "\t').lower() for word in line.split(delimiter)]
    if not AXES.keys().isdisjoint(words):
        notice_once("columns Points:0, Points:1, Points:2 are read as x, y, z")
    return tuple(AXES.get(word, word) for word in words)


def is_number(word: str) -> bool:
    """Return whether a word is a decimal number."""
    try:
        float(word)
    except ValueError:
        return False
    return True


def _numbers(content: bytes, layout: Layout, used: tuple[int, ...]) -> Double:
    """Return the used columns of the table, (N, len(used)) float64."""
    body = content[layout.start :]
    if not body.strip():
        return np.empty((0, len(used)))
    # Other delimited columns may contain text; without delimiters it could contain blanks.
    try:
        table = np.loadtxt(
            io.BytesIO(body),
            comments=None,
            delimiter=layout.delimiter,
            quotechar='"',
            usecols=used if layout.delimiter else None,
            ndmin=2,
        )
    except ValueError as error:
        raise ValueError(_first_fault(content, layout, used)) from error
    width: float = table.shape[1]
    if layout.delimiter:
        width = 1 + body.count(layout.delimiter.encode()) / len(table)
    if width != layout.width:
        raise ValueError(f"has lines of more or fewer than {layout.width} columns")
    return table if layout.delimiter else table[:, used]


def _first_fault(content: bytes, layout: Layout, used: tuple[int, ...]) -> str:
    """Return a description of the first line that differs from the layout."""
    before = content[: layout.start].count(b"\n")
    lines = content[layout.start :].decode("latin-1").split("\n")
    for number, line in enumerate(map(str.strip, lines), before + 1):
        words = _words(line, layout.delimiter)
        if line and len(words) != layout.width:
            return f"line {number} has {len(words)} columns, not {layout.width}"
        wrong = [words[i] for i in used if line and not is_number(words[i])]
        if wrong:
            return f"line {number} has {shortened(wrong[0])!r} instead of a number"
    return "is not a table of numbers"
