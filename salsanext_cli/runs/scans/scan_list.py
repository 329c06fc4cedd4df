# SPDX-License-Identifier: MIT
"""Lists of scans as a source: ``@list.txt``, a text file with one path per line.

Paths are relative to the folder of the list. Blank lines and lines that begin with # do not count.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from salsanext_cli.core.errors import NoInputError
from salsanext_cli.core.texts import counted, first_few
from salsanext_cli.io.files.listed_lines import listed_lines
from salsanext_cli.io.files.reading import present
from salsanext_cli.io.formats.recordings import recording_of

MARK = "@"
EXPECTED = "one path of a scan per line"


@dataclass(frozen=True, slots=True, kw_only=True)
class ListedPath:
    """Path in a list, absolute, and the number of its line, from 1."""

    file: Path  # The list
    number: int
    path: Path

    @contextmanager
    def naming_line(self) -> Iterator[None]:
        """Name the line of the list in the error of a path without scans."""
        try:
            yield
        except NoInputError as error:
            subject = f"{self.file}, line {self.number}"
            problem = f"{error.subject}: {error.problem}"
            raise NoInputError(subject, problem, error.expected, error.hint) from error


def list_of(source: Path) -> Path | None:
    """Return the text file that a source such as ``@list.txt`` names; None for other sources.

    A file or folder whose own name begins with the mark is that file or folder.
    """
    text = str(source)
    if not text.startswith(MARK) or text == MARK or present(source):
        return None
    return Path(text.removeprefix(MARK))


def listed_paths(file: Path) -> list[ListedPath]:
    """Return the paths of a list; refuse it if any of them does not exist.

    Parameters
    ----------
    file : Path
        The list.

    Returns
    -------
    list of ListedPath
        In the order of the list.

    Raises
    ------
    FormatError
        If the list cannot be read.
    NoInputError
        If it has no path, or paths do not exist; the error names their lines.
    """
    folder = file.absolute().parent
    listed = [
        ListedPath(file=file, number=line.number, path=folder / line.text)
        for line in listed_lines(file, EXPECTED)
    ]
    if not listed:
        raise NoInputError(file, "contains no path of a scan", EXPECTED)
    missing = [entry for entry in listed if not _exists(entry.path)]
    if missing:
        lines = first_few([f"line {entry.number}: {entry.path}" for entry in missing])
        problem = f"{len(missing)} of {counted(len(listed), 'path')} do not exist: {lines}"
        hint = f"paths are relative to {folder}"
        raise NoInputError(file, problem, "scans that exist", hint)
    return listed


def _exists(path: Path) -> bool:
    """Return whether a path exists, or leads into a recording."""
    return present(path) or recording_of(path) is not None
