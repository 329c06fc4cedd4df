# SPDX-License-Identifier: MIT
"""ZIP files whose bytes depend on their content only, written whole or not at all."""

import stat
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

from salsanext_cli.files.atomic import writing
from salsanext_cli.files.reading import reading

OLDEST = (1980, 1, 1, 0, 0, 0)
"""First date that the format knows, given to all members."""
UNIX = 3
FOLDER_IN_DOS = 0x10
LEVEL = 6
"""Of compression; given, so that it is that of every Python."""


def write_zip(
    path: Path, members: Mapping[str, Path], advance: Callable[[], None] = lambda: None
) -> None:
    """Write a ZIP file of files, with an entry for each folder before the files in it.

    `path`: the file; `members`: files by their names in the ZIP file, with slashes, in its order;
    `advance`: called after each file.
    """
    with writing(path, durable=True) as file, ZipFile(file, "w", ZIP_DEFLATED) as made:
        folders: set[str] = set()
        for name, member in members.items():
            for folder in _folders_of(name):
                if folder not in folders:
                    folders.add(folder)
                    made.writestr(_entry(folder, stat.S_IFDIR | 0o755, FOLDER_IN_DOS), b"")
            with reading(member) as opened:
                content = opened.read()
            made.writestr(_entry(name, stat.S_IFREG | 0o644), content, ZIP_DEFLATED, LEVEL)
            advance()


def _folders_of(name: str) -> Iterator[str]:
    """Yield the folders of a name, the outermost first: "a/", "a/b/" of "a/b/c"."""
    parts = name.split("/")[:-1]
    yield from ("/".join(parts[:depth]) + "/" for depth in range(1, len(parts) + 1))


def _entry(name: str, mode: int, attributes_of_dos: int = 0) -> ZipInfo:
    entry = ZipInfo(name, OLDEST)
    # Else the machine and its settings would be in the file.
    entry.create_system = UNIX
    entry.external_attr = mode << 16 | attributes_of_dos
    return entry
