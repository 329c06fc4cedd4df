# SPDX-License-Identifier: MIT
"""Scans as text: a point per line, its values separated by commas, semicolons or blanks."""

import io
import re
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.errors import FormatError, notice_once, shortened
from salsanext_cli.files.reading import reading
from salsanext_cli.formats.columns import Columns, scan_of
from salsanext_cli.formats.field_names import AxisFields, intensity_among, listed
from salsanext_cli.formats.kitti import CONTROL, TEXT_BYTES
from salsanext_cli.formats.tables.text_layout import (
    EMPTY_CELLS,
    EXPECTED,
    LEICA_SUFFIX,
    Layout,
    is_empty,
    is_number,
    layout_of,
    words_of,
)
from salsanext_cli.records import Double, Scan
from salsanext_cli.sensors.sensor import UNUSED_COLUMN

BYTE_ORDER_MARK = b"\xef\xbb\xbf"
DECIMAL_COMMA = re.compile(rb'(?:^|[;\s"])-?\d*,\d+(?:[;\s"]|$)')
"""Number with a comma between blanks or semicolons, which separate the columns."""
LEICA_OFFSETS = (128, 2048)
"""Offsets of the intensities of Leica's files: from -128 to 127, and from -2048 to 2047."""


def read_text(
    path: Path, names: tuple[str, ...], intensity_scale: float, intensity_field: str = ""
) -> Scan:
    """Read coordinates and intensity from text; without a header the columns are `names`."""
    with reading(path) as file:
        content = file.read().removeprefix(BYTE_ORDER_MARK)
    if CONTROL.search(content[:TEXT_BYTES]):
        raise FormatError(path, "is not text", "a point per line, in ASCII or UTF-8")
    try:
        layout = layout_of(content)
        columns = layout.columns(names, path)
        if layout.names and names and _lower(layout.names) != names:
            notice_once("--columns is ignored for files whose first line names the columns")
        used = _used_fields(columns, intensity_field, path)
        table = _numbers(content, layout, tuple(used.values()))
        if layout.count not in (None, len(table)):
            raise ValueError(f"has {len(table)} of the {layout.count} points in its first line")
    except ValueError as error:
        require_decimal_points(content, path)
        raise FormatError(path, shortened(str(error)), EXPECTED) from error
    values: Columns = dict(zip(used, table.T, strict=True))
    is_leica = path.suffix.lower() == LEICA_SUFFIX and not (layout.names or names)
    if is_leica and "intensity" in values:
        values = {**values, "intensity": _from_zero(values["intensity"])}
    unread = [name for name in columns if name not in used and name != UNUSED_COLUMN]
    return scan_of(values, path, intensity_scale, intensity_field, unread=unread)


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


def _from_zero(intensity: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return intensities of Leica's files (N,), which may be negative, counted from 0."""
    known = intensity[np.isfinite(intensity)]
    if len(known) and known.min() < 0 and (known == np.rint(known)).all():
        for offset in LEICA_OFFSETS:
            if -offset <= known.min() and known.max() < offset:
                notice_once(f"intensities from -{offset} in .pts files are counted from 0")
                return intensity + offset
    return intensity


def require_decimal_points(content: bytes, path: Path) -> None:
    """Refuse text with a decimal comma."""
    if match := DECIMAL_COMMA.search(content):
        number = match[0].strip(b'; \t\r\n"').decode()
        hint = "rewrite the file with decimal points"
        raise FormatError(path, f"has decimal commas: {number}", "decimal points", hint)


def _numbers(content: bytes, layout: Layout, used: tuple[int, ...]) -> Double:
    """Return the used columns of the table, (N, len(used)) float64; NaN for an empty cell."""
    body = content[layout.start :]
    if not body.strip():
        return np.empty((0, len(used)))
    try:
        table = _loaded(body, layout, used)
    except ValueError as error:
        try:
            table = _loaded(_with_nan(body, layout.delimiter), layout, used)
        except ValueError:
            raise ValueError(_first_fault(content, layout, used)) from error
    width: float = table.shape[1]
    if layout.delimiter:
        width = 1 + body.count(layout.delimiter.encode()) / len(table)
    if width != layout.width:
        raise ValueError(f"has lines of more or fewer than {layout.width} columns")
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
        mark, empty = re.escape(delimiter), rf'[ \t]*+"?(?:{words})?"?[ \t]*+'
        # A line without a delimiter is blank.
        pattern = rf"(?im)(?:(?<={mark}){empty}(?={mark}|\r?$)|^{empty}(?={mark}))"
    return re.sub(pattern.encode(), b"nan", body)


def _first_fault(content: bytes, layout: Layout, used: tuple[int, ...]) -> str:
    """Return a description of the first line that differs from the layout."""
    before = content[: layout.start].count(b"\n")
    lines = content[layout.start :].decode("latin-1").split("\n")
    for number, line in enumerate(map(str.strip, lines), before + 1):
        words = words_of(line, layout.delimiter)
        if line and len(words) != layout.width:
            return f"line {number} has {len(words)} columns, not {layout.width}"
        if not line:
            continue
        wrong = [words[i] for i in used if not is_number(words[i]) and not is_empty(words[i])]
        if wrong:
            return f"line {number} has {shortened(wrong[0])!r} instead of a number"
    return "is not a table of numbers"
