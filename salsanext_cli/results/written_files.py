# SPDX-License-Identifier: MIT
"""Record of the files that salsanext wrote into a folder, so that nothing else is ever removed.

``FOLDER/.salsanext.files/<machine>.tsv`` holds a line per file: its path below the folder
(percent-encoded), its size in bytes and its time of modification in nanoseconds. Lines are only
ever appended, each before its file gets its name. Every machine of a cluster has a record of its
own, since appending to one file over a network loses lines.
"""

import os
import re
import socket
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import BinaryIO
from urllib.parse import quote_from_bytes, unquote_to_bytes

from salsanext_cli.errors import OutputError
from salsanext_cli.files.atomic import refusal, writing
from salsanext_cli.files.reading import reading

RECORDS = ".salsanext.files"
LINE = re.compile(rb"(\S+)\t(\d{1,19})\t(\d{1,19})")
States = dict[Path, set[tuple[int, int]]]
"""Sizes and times of modification that files were written with."""


@dataclass(frozen=True, slots=True)
class WrittenFiles:
    """Record of the files that salsanext wrote below a folder."""

    folder: Path  # The folder; it need not exist

    @contextmanager
    def writing(self, path: Path, *, durable: bool = False) -> Iterator[BinaryIO]:
        """Open a file below the folder as `atomic.writing` does, and record it."""
        with writing(
            path, durable=durable, before_rename=partial(self._append, path, durable=durable)
        ) as file:
            yield file

    def write(self, path: Path, content: bytes, *, durable: bool = False) -> None:
        """Write a file below the folder whole or not at all, and record it."""
        with self.writing(path, durable=durable) as file:
            file.write(content)

    def record(self, path: Path) -> None:
        """Record a file below the folder as it is now."""
        self._append(path, path.lstat())

    def others(self, paths: Iterable[Path], states: States | None = None) -> list[Path]:
        """Return those of some files that are there and not as salsanext wrote them.

        They were changed since, are not recorded, or are reached through a link below the folder.
        An empty file, as a power cut leaves it, counts as one of ours. Who asks often gives the
        `states` that he has read once.
        """
        there = {path: path.lstat() for path in paths if os.path.lexists(path)}
        if states is None:
            states = self.states() if there else {}
        return [
            path
            for path, status in there.items()
            if self._behind_link(path)
            or (status.st_size and (status.st_size, status.st_mtime_ns) not in states.get(path, ()))
        ]

    def require_replaceable(self, paths: Iterable[Path]) -> None:
        """Refuse to replace files that salsanext did not write, or that were changed since."""
        if others := self.others(paths):
            found = "exists, and was not recorded by salsanext or was changed since"
            raise OutputError(others[0], found, remedy="move it, or use another folder")

    def remove(self, paths: Iterable[Path]) -> list[Path]:
        """Remove some files if they are as salsanext wrote them; return those that are kept."""
        paths = list(paths)
        kept = self.others(paths)
        for path in {*paths} - {*kept}:
            # A folder of that name is not ours; who wants to write there will name it.
            if path.is_dir():
                continue
            try:
                path.unlink(missing_ok=True)
            except OSError as error:
                raise refusal(path, error) from error
        return kept

    def recorded(self) -> list[Path]:
        """Return every recorded file that is there, whatever became of it, sorted."""
        return sorted(path for path in self.states() if os.path.lexists(path))

    def _behind_link(self, path: Path) -> bool:
        above = path.relative_to(self.folder).parents[:-1]
        return path.is_symlink() or any((self.folder / part).is_symlink() for part in above)

    def states(self) -> States:
        """Read what is recorded."""
        states: States = {}
        for record in sorted((self.folder / RECORDS).glob("*.tsv")):
            with reading(record) as file:
                # A line that was cut off says nothing.
                lines = [match for line in file if (match := LINE.fullmatch(line.rstrip()))]
            for name, size, time_ns in (line.groups() for line in lines):
                below = Path(os.fsdecode(unquote_to_bytes(name)))
                # Anybody may have written a record; it is of files below the folder only.
                if not below.is_absolute() and ".." not in below.parts:
                    state = int(size), int(time_ns)
                    states.setdefault(self.folder / below, set()).add(state)
        return states

    def _append(self, path: Path, status: os.stat_result, *, durable: bool = False) -> None:
        machine = re.sub(r"[^\w.-]", "_", socket.gethostname())
        record = self.folder / RECORDS / f"{machine}.tsv"
        name = quote_from_bytes(os.fsencode(path.relative_to(self.folder)))
        # The line end comes first too: the line before may have been cut off.
        line = f"\n{name}\t{status.st_size}\t{status.st_mtime_ns}\n".encode()
        try:
            record.parent.mkdir(parents=True, exist_ok=True)
            # Unbuffered, it is one write, and those of other processes do not mix with it.
            with record.open("ab", buffering=0) as file:
                file.write(line)
                if durable:
                    os.fsync(file.fileno())
        except OSError as error:
            raise refusal(record, error) from error
