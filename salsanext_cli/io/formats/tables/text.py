# SPDX-License-Identifier: MIT
"""Scans as text: a point per line, its values separated by commas, semicolons or blanks."""

import io
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from salsanext_cli.core.errors import FormatError
from salsanext_cli.core.notices import notice_once
from salsanext_cli.core.records import Double, Scan
from salsanext_cli.core.sensors.sensor import UNUSED_COLUMN
from salsanext_cli.core.texts import shortened
from salsanext_cli.core.wording import argument
from salsanext_cli.io.files.reading import reading
from salsanext_cli.io.formats.columns import Columns, scan_of
from salsanext_cli.io.formats.evidence.file_kinds import CONTROL, TEXT_BYTES
from salsanext_cli.io.formats.field_names import AxisFields, intensity_among, listed
from salsanext_cli.io.formats.tables.text_layout import (
    COMMENT_MARKS,
    EMPTY_CELLS,
    EXPECTED,
    MARKS,
    TAB,
    Layout,
    is_empty,
    is_number,
    layout_of,
    stripped,
    without_comments,
    words_of,
)

BYTE_ORDER_MARK = b"\xef\xbb\xbf"
DECIMAL_COMMA = re.compile(rb'(?:^|[;\s"])-?\d*,\d+(?:[;\s"]|$)')
"""Number with a comma between blanks or semicolons, which separate the columns."""
EMPTY_ROW = re.compile(rb"(?m)^\t+\r?$")  # Row of a table whose cells are separated by tabs


@dataclass(frozen=True, slots=True, kw_only=True)
class TextTable:
    """Columns of a table of text."""

    columns: tuple[str, ...]  # All names
    values: Columns  # Coordinates and intensity by name, (N,) float64


def read_text(
    path: Path, names: tuple[str, ...], intensity_scale: float, intensity_field: str = ""
) -> Scan:
    """Read coordinates and intensity from text.

    Parameters
    ----------
    path : Path
        The file.
    names : tuple of str
        Names of the columns of a file without a header; empty for the usual ones.
    intensity_scale : float
        Divisor of the intensity.
    intensity_field : str
        Name of the column with the intensity; by default a usual one.

    Returns
    -------
    Scan
        N points, in the order of the file.

    Raises
    ------
    FormatError
        If the file is not text, or not a table of numbers.
    """
    with reading(path) as file:
        content = file.read().removeprefix(BYTE_ORDER_MARK)
    if CONTROL.search(content[:TEXT_BYTES]):
        raise FormatError(path, "is not text", "a point per line, in ASCII or UTF-8")
    try:
        table = _text_table(content, names, intensity_field, path)
    except ValueError as error:
        require_decimal_points(content, path)
        raise FormatError(path, shortened(str(error)), EXPECTED) from error
    unread = [name for name in table.columns if name not in table.values and name != UNUSED_COLUMN]
    return scan_of(table.values, path, intensity_scale, intensity_field, unread=unread)


def _text_table(
    content: bytes, names: tuple[str, ...], intensity_field: str, path: Path
) -> TextTable:
    """Read a table of text; tabs are blanks unless empty cells stand between them."""
    if not EMPTY_ROW.search(content):
        try:
            return _table_of(content, layout_of(content), names, intensity_field, path)
        except ValueError:
            if TAB.encode() not in content:
                raise
    return _table_of(content, layout_of(content, MARKS + TAB), names, intensity_field, path)


def _table_of(
    content: bytes, layout: Layout, names: tuple[str, ...], intensity_field: str, path: Path
) -> TextTable:
    """Read the table of a layout; refuse one with other lines than the layout."""
    columns = layout.columns(names, path)
    if layout.names and names and _lower(layout.names) != names:
        ignored = f"{argument('columns')} is ignored"
        notice_once(f"{ignored} for files whose first line names the columns")
    used = _used_fields(columns, intensity_field, path)
    table = _numbers(content, layout, tuple(used.values()))
    if layout.count not in (None, len(table)):
        raise ValueError(f"has {len(table)} of the {layout.count} points in its first line")
    return TextTable(columns=columns, values=dict(zip(used, table.T, strict=True)))


def _lower(names: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(name.lower() for name in names)


def _used_fields(columns: tuple[str, ...], intensity_field: str, path: Path) -> dict[str, int]:
    """Return the places of coordinates and intensity among the columns by their names."""
    names = list(AxisFields.among(columns, path).names)
    intensity = intensity_among(columns, intensity_field, path)
    names += [intensity] if intensity else []
    if any(_lower(columns).count(name.lower()) > 1 for name in names):
        raise ValueError(f"repeats a column in {listed(columns)}")
    return {name: columns.index(name) for name in names}


def require_decimal_points(content: bytes, path: Path) -> None:
    """Refuse text with a decimal comma."""
    match = DECIMAL_COMMA.search(content)
    if match:
        number = match[0].strip(b'; \t\r\n"').decode()
        hint = "rewrite the file with decimal points"
        raise FormatError(path, f"has decimal commas: {number}", "decimal points", hint)


def _numbers(content: bytes, layout: Layout, used: tuple[int, ...]) -> Double:
    """Return the used columns of the table, (N, len(used)) float64; NaN for an empty cell."""
    body = without_comments(content[layout.start :])
    if not body.strip():
        return np.empty((0, len(used)))
    try:
        table = _loaded(body, layout, used)
    except ValueError as error:
        try:
            table = _loaded(_with_nan(body, layout.delimiter), layout, used)
        except ValueError:
            raise ValueError(_first_fault(content, layout, used)) from error
    widths = {table.shape[1]}
    if layout.delimiter:
        mark = layout.delimiter.encode()
        widths = {1 + line.count(mark) for line in body.splitlines() if line.strip()}
    if widths != {layout.width}:
        raise ValueError(_first_fault(content, layout, used))
    return table if layout.delimiter else table[:, used]


def _loaded(body: bytes, layout: Layout, used: tuple[int, ...]) -> Double:
    # Other delimited columns may contain text; without delimiters it could contain blanks.
    return np.loadtxt(
        io.BytesIO(body),
        comments=None,
        delimiter=layout.delimiter,
        quotechar='"',
        usecols=used if layout.delimiter else None,
        ndmin=2,
    )


def _with_nan(body: bytes, delimiter: str | None) -> bytes:
    """Return lines with NaN in the cells without a value."""
    words = "|".join(sorted(filter(None, EMPTY_CELLS), key=len, reverse=True))
    pattern = rf"(?i)(?<!\S)(?:{words})(?!\S)"
    if delimiter is not None:
        blank = "[ ]" if delimiter == TAB else r"[ \t]"
        mark = re.escape(delimiter)
        empty = rf'{blank}*+"?(?:{words})?"?{blank}*+'
        # A line without a delimiter is blank.
        pattern = rf"(?im)(?:(?<={mark}){empty}(?={mark}|\r?$)|^{empty}(?={mark}))"
    return re.sub(pattern.encode(), b"nan", body)


def _first_fault(content: bytes, layout: Layout, used: tuple[int, ...]) -> str:
    """Return a description of the first line that differs from the layout."""
    before = content[: layout.start].count(b"\n")
    lines = content[layout.start :].decode("latin-1").split("\n")
    for number, line in enumerate(lines, before + 1):
        if not line.strip() or line.lstrip().startswith(COMMENT_MARKS):
            continue
        words = words_of(stripped(line, layout.delimiter), layout.delimiter)
        if len(words) != layout.width:
            return f"line {number} has {len(words)} columns, not {layout.width}"
        wrong = [words[i] for i in used if not is_number(words[i]) and not is_empty(words[i])]
        if wrong:
            return f"line {number} has {shortened(wrong[0])!r} instead of a number"
    return "is not a table of numbers"
