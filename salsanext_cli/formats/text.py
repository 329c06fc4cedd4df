# SPDX-License-Identifier: MIT
"""Scans as text: a point in each line, its values separated by commas, semicolons or blanks."""

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
"""Axes by the names of their columns, in lower case, in what VeloView and ParaView write."""
EXPECTED = "a point in each line, with the same number of columns"
DECIMAL_COMMA = re.compile(rb'(?:^|[;\s"])-?\d*,\d+(?:[;\s"]|$)')
"""Number whose comma separates no columns, since blanks or semicolons do."""


@dataclass(frozen=True, slots=True)
class Layout:
    """Layout of a table of text."""

    start: int  # Offset of the first point in bytes
    delimiter: str | None  # Character between values; None for blanks
    width: int  # Number of columns
    names: tuple[str, ...]  # Names of the columns in lower case; empty if the file has none
    count: int | None = None  # Number of points, where the first line is nothing else


def text_columns(path: Path, names: tuple[str, ...]) -> Columns:
    """Read coordinates and intensity from text; `names` or the usual ones if it has none itself."""
    with reading(path) as file:
        content = file.read().removeprefix(BYTE_ORDER_MARK)
    if CONTROL.search(content[:TEXT_BYTES]):
        raise FormatError(path, "not text", "a point in each line, in ASCII or UTF-8")
    try:
        layout = layout_of(content, has_names=bool(names))
        if layout.names and names and layout.names != names:
            notice_once("--columns is not used for files whose first line names the columns")
        names = layout.names or columns_of_width(layout.width, names, path)
        used = {name: i for i, name in enumerate(names) if name in USED_NAMES}
        if len(used) < sum(name in USED_NAMES for name in names):
            raise ValueError(f"a column twice among {shortened(', '.join(names))}")
        if not {"x", "y", "z"} & set(used):
            raise ValueError(f"points of {shortened(', '.join(names))}")
        table = _numbers(content, layout, tuple(used.values()))
        if layout.count not in (None, len(table)):
            raise ValueError(f"{len(table)} of the {layout.count} points that its first line says")
    except ValueError as error:
        require_decimal_points(content, path)
        raise FormatError(path, shortened(str(error)), EXPECTED) from error
    return dict(zip(used, table.T, strict=True))


def require_decimal_points(content: bytes, path: Path) -> None:
    """Refuse text with a decimal comma, as the reason why it is no table."""
    if found := DECIMAL_COMMA.search(content):
        number = found[0].strip(b'; \t\r\n"').decode()
        hint = "write the file again with decimal points"
        raise FormatError(path, f"decimal commas: {number}", "decimal points", hint)


def layout_of(content: bytes, has_names: bool) -> Layout:
    """Find the first point, after a header or a number alone and what text follows that."""
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
                raise ValueError(f"{shortened(line)} in place of numbers, or of names with x, y, z")
            return Layout(end, delimiter, len(words), (), count)
        at = end
    raise ValueError("no points")


def _words(line: str, delimiter: str | None) -> tuple[str, ...]:
    """Return the fields of a line, in lower case, without blanks and quotes around them."""
    words = [word.strip(' "\t').lower() for word in line.split(delimiter)]
    if not AXES.keys().isdisjoint(words):
        notice_once("columns Points:0, Points:1, Points:2 are read as x, y, z")
    return tuple(AXES.get(word, word) for word in words)


def is_number(word: str) -> bool:
    """Say whether a word is a number, in decimal notation."""
    try:
        float(word)
    except ValueError:
        return False
    return True


def _numbers(content: bytes, layout: Layout, used: tuple[int, ...]) -> Double:
    """Return some columns of the table, (N, len(used)) float64."""
    body = content[layout.start :]
    if not body.strip():
        return np.empty((0, len(used)))
    # Of delimited columns others may hold text; blanks may be in it, so then all are numbers.
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
        raise ValueError(f"lines of more or fewer than {layout.width} columns")
    return table if layout.delimiter else table[:, used]


def _first_fault(content: bytes, layout: Layout, used: tuple[int, ...]) -> str:
    """Say where the table does not go on as it began."""
    before = content[: layout.start].count(b"\n")
    lines = content[layout.start :].decode("latin-1").split("\n")
    for number, line in enumerate(map(str.strip, lines), before + 1):
        words = _words(line, layout.delimiter)
        if line and len(words) != layout.width:
            return f"line {number} has {len(words)} columns, not {layout.width}"
        wrong = [words[i] for i in used if line and not is_number(words[i])]
        if wrong:
            return f"line {number} has {shortened(wrong[0])!r} in place of a number"
    return "no table of numbers"
