# SPDX-License-Identifier: MIT
"""Layout of a table of text: where its points begin, its delimiter, and the names of its columns.

Programs name the columns in the first line, or in a comment; Leica's `.pts` has fixed ones.
"""

import re
from dataclasses import dataclass
from pathlib import Path

from salsanext_cli.core.errors import FormatError
from salsanext_cli.core.texts import quoted
from salsanext_cli.core.wording import setting
from salsanext_cli.io.formats.columns import columns_of_width, names_to_try
from salsanext_cli.io.formats.field_names import AXES, has_axes

COMMENT_MARKS = ("#", "//", "%")
COMMENT_LINE = re.compile(rb"(?m)^[ \t]*(?:#|//|%).*(?:\n|\Z)")
TAB = "\t"
MARKS = ";,"  # Characters between values, in order of precedence
MAX_HEADER_BYTES = 1 << 16
EXPECTED = "a point per line, with the same number of columns"
LEICA_SUFFIX = ".pts"
LEICA_COLUMNS = {
    7: ("x", "y", "z", "intensity", "red", "green", "blue"),
    6: ("x", "y", "z", "red", "green", "blue"),
}
"""Columns of Leica's format by their number; fewer ones are the usual ones."""
EMPTY_CELLS = ("", "na", "n/a", "null", "none")
"""Contents, in lower case, of a cell without a value."""


@dataclass(frozen=True, slots=True)
class Layout:
    """Layout of a table of text."""

    start: int  # Offset of the first point in bytes
    delimiter: str | None  # Character between values; None for blanks
    width: int  # Number of columns
    names: tuple[str, ...]  # Names of the columns; empty if the file has none with coordinates
    count: int | None = None  # Number of points, if the first line consists of it
    header: str = ""  # First line of text, if it does not name the coordinates

    def columns(self, requested: tuple[str, ...], path: Path) -> tuple[str, ...]:
        """Return the names of the columns: the file's, else the requested or the usual ones."""
        if self.names:
            return self.names
        if requested:
            return columns_of_width(self.width, requested, path)
        if self.header:
            raise self._unusable_header(path)
        is_leica = str(path).lower().endswith(LEICA_SUFFIX)
        if is_leica and self.width in LEICA_COLUMNS:
            return LEICA_COLUMNS[self.width]
        return columns_of_width(self.width, (), path)

    def _unusable_header(self, path: Path) -> FormatError:
        """Return the error of a header without the names of coordinates."""
        problem = f"has {quoted(self.header)} instead of numbers or names x, y, z"
        hint = ""
        if self.width >= len(AXES):
            named = setting("columns", names_to_try(self.width))
            hint = f"if it has coordinates, name them: {named}"
        return FormatError(path, problem, EXPECTED, hint)


def layout_of(content: bytes, marks: str = MARKS) -> Layout:
    """Return the layout from the first point, after a header or a number and further text.

    `marks` are the characters that may stand between values; without one, blanks and tabs do.
    """
    at = 0
    names: tuple[str, ...] = ()
    count: int | None = None
    while at < min(len(content), MAX_HEADER_BYTES):
        end = content.find(b"\n", at) + 1 or len(content)
        text = content[at:end].decode("utf-8", "replace")
        line = text.strip()
        delimiter = _delimiter_of(stripped(text, TAB), marks)
        words = words_of(stripped(text, delimiter), delimiter)
        if line.startswith(COMMENT_MARKS):
            comment = words_of(line.lstrip("#/% \t"), delimiter)
            names = comment if has_axes(comment) else names
        elif count is None and len(words) == 1 and words[0].isdecimal():
            count = int(words[0])
        elif is_row(words, count is not None):
            # A comment is a header only if it fits.
            fitting = names if len(names) == len(words) else ()
            return Layout(at, delimiter, len(words), fitting, count)
        elif has_axes(words):
            return Layout(end, delimiter, len(words), words, count)
        elif line and count is None:
            if not _is_followed(content[end:], delimiter, len(words)):
                raise ValueError(f"has {quoted(line)} instead of numbers or names x, y, z")
            return Layout(end, delimiter, len(words), (), count, header=line)
        at = end
    raise ValueError("has no points")


def _delimiter_of(line: str, marks: str) -> str | None:
    """Return the first of the marks in a line; None for blanks."""
    return next((mark for mark in marks if mark in line), None)


def stripped(line: str, delimiter: str | None) -> str:
    """Return a line without surrounding blanks; tabs that separate cells stay."""
    return line.strip(" \r\n") if delimiter == TAB else line.strip()


def without_comments(body: bytes) -> bytes:
    """Return the lines of points without the comments between them."""
    if any(mark.encode() in body for mark in COMMENT_MARKS):
        return COMMENT_LINE.sub(b"", body)
    return body


def _is_followed(content: bytes, delimiter: str | None, width: int) -> bool:
    """Return whether the first line of a content is a row of as many columns."""
    line = content[:MAX_HEADER_BYTES].lstrip().partition(b"\n")[0].decode("utf-8", "replace")
    words = words_of(stripped(line, delimiter), delimiter)
    return len(words) == width and is_row(words, are_counted=False)


def is_row(words: tuple[str, ...], are_counted: bool) -> bool:
    """Return whether the words of a line are the values of a point, some of which may be empty.

    After the number of points all are numbers; before, other columns may contain text.
    """
    values = [word for word in words if not is_empty(word)]
    if not values:
        return len(words) > 1
    return (all if are_counted else any)(map(is_number, values))


def words_of(line: str, delimiter: str | None) -> tuple[str, ...]:
    """Return the fields of a line, without surrounding blanks and quotes."""
    if delimiter is None:
        return tuple(_joined_units(line.replace('"', "").split()))
    return tuple(word.strip(' "\t') for word in line.split(delimiter))


def _joined_units(words: list[str]) -> list[str]:
    """Return words with units in brackets joined to the word before, as ``x (m)``."""
    joined: list[str] = []
    for word in words:
        if joined and word[0] in "([" and word[-1] in ")]":
            joined[-1] = f"{joined[-1]} {word}"
        else:
            joined.append(word)
    return joined


def is_number(word: str) -> bool:
    """Return whether a word is a decimal number."""
    try:
        float(word)
    except ValueError:
        return False
    return True


def is_empty(word: str) -> bool:
    """Return whether a cell has no value."""
    return word.lower() in EMPTY_CELLS
