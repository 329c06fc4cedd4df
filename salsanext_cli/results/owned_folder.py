# SPDX-License-Identifier: MIT
"""Folder that a stage fills: its locks, the list of the files that were written, its findings.

``FOLDER/.salsanext.files/<machine>.tsv`` holds a line per file: its path below the folder
(percent-encoded), its size in bytes and its time of modification in nanoseconds. Lines are only
ever appended, each before its file gets its name. Every machine of a cluster has a list of its
own, since appending to one file over a network loses lines. Files that are not on a list, or were
changed since, are never removed; `OwnedFolder.remove_own` is all that removes results.
"""

import logging
import os
import re
import socket
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import BinaryIO
from urllib.parse import quote_from_bytes, unquote_to_bytes
from uuid import uuid4

from salsanext_cli.errors import OutputError, first_few
from salsanext_cli.files.atomic import MARK, append_line, refusal, sweep, sweep_stale, writing
from salsanext_cli.files.json_files import read_record, write_json
from salsanext_cli.files.locks import locked
from salsanext_cli.files.reading import filled, present, reading
from salsanext_cli.results.manifest import Manifest

FILE_LISTS = ".salsanext.files"
PLACES = (
    *("sequences/*/", "sequences/*/*/", "sequences/*/*/*/"),
    *("samples/", "folds/*/", "folds/*/samples/", "eval/*/"),
)
"""Folders below that stages write into."""
RECORDS_LOCK_TIMEOUT_S = 1800.0
"""There may be a hundred others, which hold the lock for seconds each if it is a million scans."""
LINE = re.compile(rb"(\S+)\t(\d{1,19})\t(\d{1,19})")
States = dict[Path, set[tuple[int, int]]]  # Size and time of modification at each writing
Texts = tuple[str, str, str]  # Code, message and hint of a finding

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class _Findings:
    """Reasons to doubt the scans of all runs of a stage."""

    stage: str
    scans: dict[str, list[Texts]]  # By name of the scan


@dataclass(frozen=True, slots=True)
class OwnedFolder:
    """Folder that a stage fills; small enough to be sent to other processes."""

    root: Path  # The folder; it need not exist
    stage: str = ""  # Name of the stage on the command line
    part: str = ""  # Folder below the root that has lock and record, if it is not the root

    @property
    def manifest(self) -> Manifest:
        """Records of the stages that ran in the folder."""
        return Manifest(self.root / self.part)

    @property
    def record_path(self) -> Path:
        """Path of the record of the stage's settings."""
        return self.manifest.path(self.stage)

    @contextmanager
    def open(self, *, shared: bool = False) -> Iterator[None]:
        """Keep other runs of the stage out of the folder, unless it is shared; sweep it."""
        mark = uuid4().hex
        # Runs of other threads of this process keep their temporary files.
        token = MARK.set(mark)
        name = f".{self.stage}.{mark}.lock" if shared else f".{self.stage}.lock"
        try:
            with locked(self.root / self.part / name, stage=self.stage):
                for place in self._places():
                    sweep_stale(place)
                try:
                    yield
                finally:
                    for place in self._places():
                        sweep(place, mark)
        finally:
            MARK.reset(token)

    def is_shared(self) -> bool:
        """Say whether runs of the stage share the folder now; locks of killed runs are removed."""
        busy = False
        for lock in self.root.glob(f".{self.stage}.*.lock"):
            try:
                with locked(lock):
                    pass
            except OutputError:
                busy = True
        return busy

    def busy(self) -> OutputError:
        """Return the error of a folder that a run of the stage fills now."""
        hint = "wait until it has ended, or use another folder"
        return OutputError(self.root, f"a run of `{self.stage}` is at work in it", hint=hint)

    def locked_records(self) -> AbstractContextManager[None]:
        """Keep other processes from the records of the folder while the body runs."""
        return locked(self.root / ".records.lock", RECORDS_LOCK_TIMEOUT_S)

    def _places(self) -> list[Path]:
        return [self.root, *(place for below in PLACES for place in self.root.glob(below))]

    def require_new(self) -> None:
        """Refuse a folder that holds something, but no record of the stage."""
        if present(self.record_path) or not present(self.root):
            return
        if not self.root.is_dir() or any(p.name[0] != "." for p in self.root.iterdir()):
            raise OutputError(self.root, "holds something else", "a new or empty folder")

    @contextmanager
    def writing(self, path: Path, *, durable: bool = False) -> Iterator[BinaryIO]:
        """Open a file of the folder as `atomic.writing` does, and list it."""
        listed = partial(self._list, path, durable=durable)
        with writing(path, durable=durable, before_rename=listed) as file:
            yield file

    def write(self, path: Path, content: bytes, *, durable: bool = False) -> None:
        """Write a file of the folder whole or not at all, and list it."""
        with self.writing(path, durable=durable) as file:
            file.write(content)

    def write_missing(self, path: Path, content: bytes) -> None:
        """Write a file of the folder, unless it is there: it may be edited."""
        if not filled(path):
            self.write(path, content)

    def replace(self, files: Mapping[Path, bytes], absent: Iterable[Path] = ()) -> None:
        """Write files durably in the place of earlier ones; remove those that are to be absent."""
        absent = list(absent)
        with self.locked_records():
            sweep_stale(self.root)
            self.require_own([*files, *absent])
            self.remove_own(absent)
            for path, content in files.items():
                self.write(path, content, durable=True)

    def add(self, path: Path) -> None:
        """List a file of the folder as it is now."""
        self._list(path, path.lstat())

    def foreign_files(self, paths: Iterable[Path], states: States | None = None) -> list[Path]:
        """Return those of some files that are there and changed, not listed, or behind a link."""
        there = {path: path.lstat() for path in paths if os.path.lexists(path)}
        if states is None:
            states = self.states() if there else {}

        def is_own(path: Path, status: os.stat_result) -> bool:
            # An empty file, as a power cut leaves it, is one of ours.
            listed = (status.st_size, status.st_mtime_ns) in states.get(path, ())
            return (listed or status.st_size == 0) and not self._behind_link(path)

        return [path for path, status in there.items() if not is_own(path, status)]

    def require_own(self, paths: Iterable[Path]) -> None:
        """Refuse to replace files that salsanext did not write, or that were changed since."""
        if others := self.foreign_files(paths):
            raise not_own(others[0])

    def remove_own(self, paths: Iterable[Path]) -> list[Path]:
        """Remove some files if they are as salsanext wrote them; name and return the others."""
        paths = list(paths)
        kept = self.foreign_files(paths)
        for path in {*paths} - {*kept}:
            # A folder of that name is not ours; who wants to write there will name it.
            if path.is_dir():
                continue
            try:
                path.unlink(missing_ok=True)
            except OSError as error:
                raise refusal(path, error) from error
        if kept:
            log.warning("kept, since changed or not written by salsanext: %s", first_few(kept))
        return kept

    def written(self) -> list[Path]:
        """Return every listed file that is there, whatever became of it, sorted."""
        return sorted(path for path in self.states() if os.path.lexists(path))

    def states(self) -> States:
        """Read the lists of written files."""
        states: States = {}
        for listing in sorted((self.root / FILE_LISTS).glob("*.tsv")):
            with reading(listing) as file:
                # A line that was cut off says nothing.
                lines = [match for line in file if (match := LINE.fullmatch(line.rstrip()))]
            for name, size, time_ns in (line.groups() for line in lines):
                below = Path(os.fsdecode(unquote_to_bytes(name)))
                # Anybody may have written a list; it is of files below the folder only.
                if not below.is_absolute() and ".." not in below.parts:
                    state = int(size), int(time_ns)
                    states.setdefault(self.root / below, set()).add(state)
        return states

    def findings(self) -> dict[str, list[Texts]]:
        """Return what runs of the stage found, by the name of the scan; empty if none is kept."""
        recorded = read_record(_Findings, self._findings_path)
        return recorded.scans if recorded else {}

    def keep_findings(
        self, found: Mapping[str, list[Texts]], looked_at: Collection[str]
    ) -> dict[str, list[Texts]]:
        """Keep what a run found, by scan; return what earlier runs found of scans not looked at."""
        with self.locked_records():
            known = self.findings()
            earlier = {name: texts for name, texts in known.items() if name not in looked_at}
            if present(self._findings_path) or found:
                everything = {**earlier, **{name: sorted(texts) for name, texts in found.items()}}
                scans = dict(sorted(everything.items()))
                write_json(self._findings_path, _Findings(self.stage, scans))
        return earlier

    @property
    def _findings_path(self) -> Path:
        return self.root / f"{self.stage}.warnings.json"

    def _behind_link(self, path: Path) -> bool:
        above = path.relative_to(self.root).parents[:-1]
        return path.is_symlink() or any((self.root / part).is_symlink() for part in above)

    def _list(self, path: Path, status: os.stat_result, *, durable: bool = False) -> None:
        machine = re.sub(r"[^\w.-]", "_", socket.gethostname())
        listing = self.root / FILE_LISTS / f"{machine}.tsv"
        name = quote_from_bytes(os.fsencode(path.relative_to(self.root)))
        line = f"{name}\t{status.st_size}\t{status.st_mtime_ns}".encode()
        append_line(listing, line, durable=durable)


def not_own(path: Path) -> OutputError:
    """Return the error of a file that is kept, since it is not as salsanext wrote it."""
    found = "was changed, or not written by salsanext, and is kept"
    found = "is a link, and is kept" if path.is_symlink() else found
    return OutputError(path, found, hint="move it, or use another output folder")
