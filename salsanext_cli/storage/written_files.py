# SPDX-License-Identifier: MIT
"""Record of the files that a command wrote into a folder, so that it removes no others."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from salsanext_cli.errors import OutputError
from salsanext_cli.storage.atomic import refusal, write_text


class WrittenFiles:
    """Files that were written into a folder, with their size and time of change.

    The record is a text file in that folder, one line per file: relative path, size in bytes and
    time of change in nanoseconds, separated by tabs. Several processes may append to it.

    Parameters
    ----------
    folder : Path
        The folder; nothing outside of it is ever recorded or removed.
    name : str
        Name of the record.
    """

    def __init__(self, folder: Path, name: str) -> None:
        self.folder = folder
        self.path = folder / name
        self._known: dict[str, tuple[int, int]] = {}
        if not self.path.is_file():
            return
        for line in self.path.read_text("utf-8", "surrogateescape").splitlines():
            with suppress(ValueError):  # A line that was cut off says nothing.
                written, size, changed_ns = line.split("\t")
                self._known[written] = int(size), int(changed_ns)

    def record(self, path: Path) -> None:
        """Record a file that has just been written.

        Raises
        ------
        OutputError
            If the record cannot be written.
        """
        name, found = path.relative_to(self.folder).as_posix(), path.lstat()
        self._known[name] = found.st_size, found.st_mtime_ns
        try:
            with self.path.open("a", encoding="utf-8", errors="surrogateescape") as file:
                file.write(f"{name}\t{found.st_size}\t{found.st_mtime_ns}\n")
        except OSError as error:
            raise refusal(self.path, error) from error

    def owns(self, path: Path) -> bool:
        """Tell whether a file was recorded, is as it was written, and is not behind a link."""
        try:
            below = path.relative_to(self.folder)
            found = path.lstat()
        except (ValueError, OSError):
            return False
        on_the_way = [self.folder / parent for parent in below.parents] + [path]
        linked = any(part.is_symlink() for part in on_the_way if part != self.folder)
        unchanged = self._known.get(below.as_posix()) == (found.st_size, found.st_mtime_ns)
        return unchanged and not linked and ".." not in below.parts

    def remove_all(self) -> list[Path]:
        """Remove all files that are owned; return the recorded ones that changed and stay.

        Raises
        ------
        OutputError
            If a file cannot be removed.
        """
        kept = []
        for name in sorted(self._known):
            path = self.folder / name
            if self.owns(path):
                try:
                    path.unlink()
                except OSError as error:
                    raise OutputError(path, f"cannot be removed: {error.strerror}") from error
            elif path.exists() or path.is_symlink():
                kept.append(path)
        self._known = {
            name: known for name, known in self._known.items() if self.folder / name in kept
        }
        lines = (f"{name}\t{size}\t{time}\n" for name, (size, time) in self._known.items())
        if self._known:
            write_text(self.path, "".join(lines))
        else:
            self.path.unlink(missing_ok=True)
        return kept
