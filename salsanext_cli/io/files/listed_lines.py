# SPDX-License-Identifier: MIT
"""Text files with one entry per line, blank lines and comments."""

from dataclasses import dataclass
from pathlib import Path

from salsanext_cli.core.errors import FormatError
from salsanext_cli.io.files.reading import reading

COMMENT = "#"


@dataclass(frozen=True, slots=True, kw_only=True)
class ListedLine:
    """Entry of a file, without the spaces around it, and the number of its line, from 1."""

    number: int
    text: str


def listed_lines(path: Path, expected: str) -> list[ListedLine]:
    """Read the entries of a text file; blank lines and lines that begin with # are none.

    Parameters
    ----------
    path : Path
        The file, in UTF-8.
    expected : str
        Content that is required, in words.

    Returns
    -------
    list of ListedLine
        In the order of the file; it may be empty.

    Raises
    ------
    FormatError
        If the file cannot be read, or is no text.
    """
    with reading(path) as file:
        content = file.read()
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise FormatError(path, "is no text in UTF-8", expected) from None
    if "\0" in text:
        raise FormatError(path, "is no text", expected)
    entries = [
        ListedLine(number=number, text=line.strip())
        for number, line in enumerate(text.split("\n"), start=1)
    ]
    return [entry for entry in entries if entry.text and not entry.text.startswith(COMMENT)]
