# SPDX-License-Identifier: MIT
"""Folder that a stage fills: its locks, the list of written files, warnings of its runs.

``FOLDER/.salsanext.files/<machine>.tsv`` has a line per file: its path below the folder
(percent-encoded), its size in bytes and its time of modification in nanoseconds. Lines are only
appended, each before its file gets its name. Each machine of a cluster has a separate list, since
appending to one file over a network loses lines. A file is foreign if it is not listed, was changed
since, or lies behind a link. Foreign files are never replaced or removed.
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
from urllib.parse import quote_from_bytes, unquote_to_bytes
from uuid import uuid4

from salsanext_cli.core.errors import OutputError
from salsanext_cli.core.texts import first_few
from salsanext_cli.io.files.atomic import MARK, append_line, refusal, sweep, sweep_stale, writing
from salsanext_cli.io.files.json_files import read_record, write_json
from salsanext_cli.io.files.locks import locked, removed_if_empty
from salsanext_cli.io.files.reading import filled, is_folder, present, reading
from salsanext_cli.runs.results.manifest import Manifest
from salsanext_cli.runs.results.scan_folders import FILE_LISTS

PLACES = (*("sequences/*/", "sequences/*/*/", "sequences/*/*/*/"), *("folds/*/", "eval/*/"))
"""Subfolders that stages write into."""
RECORDS_LOCK_TIMEOUT_S = 1800.0
"""A hundred other processes may hold the lock for seconds each in runs on a million scans."""
LINE = re.compile(rb"(\S+)\t(\d{1,19})\t(\d{1,19})")
States = dict[Path, set[tuple[int, int]]]  # Size and time of modification at each writing
Texts = tuple[str, str, str]  # Code, message and hint of a warning

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Findings:
    """Warnings about the scans of all runs of a stage."""

    stage: str
    scans: dict[str, list[Texts]]  # By name of the scan


@dataclass(frozen=True, slots=True)
class OwnedFolder:
    """Folder that a stage fills; small enough to be sent to other processes."""

    root: Path  # The folder may not exist yet
    stage: str = ""  # Name of the stage on the command line
    part: str = ""  # Subfolder with lock and record, if it is not the root

    @property
    def manifest(self) -> Manifest:
        """Records of the stages that ran in the folder."""
        return Manifest(self.root / self.part)

    @property
    def record_path(self) -> Path:
        """Path of the record of the stage."""
        return self.manifest.path(self.stage)

    @contextmanager
    def open(self, *, shared: bool = False) -> Iterator[None]:
        """Lock the folder against other runs of the stage, unless it is shared; sweep it."""
        mark = uuid4().hex
        # Temporary files of other threads of this process stay.
        token = MARK.set(mark)
        name = f".{self.stage}.{mark}.lock" if shared else f".{self.stage}.lock"
        try:
            folder = self.root / self.part
            with removed_if_empty(folder), locked(folder / name, stage=self.stage):
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
        """Return whether runs of the stage use the folder now; remove locks of killed runs."""
        busy = False
        for lock in self.root.glob(f".{self.stage}.*.lock"):
            try:
                with locked(lock):
                    pass
            except OutputError:
                busy = True
        return busy

    def busy(self) -> OutputError:
        """Return the error of a folder that a run of the stage uses now."""
        hint = "wait until it has ended, or use another folder"
        return OutputError(self.root, f"is in use by a run of `{self.stage}`", hint=hint)

    def locked_records(self) -> AbstractContextManager[None]:
        """Lock the records of the folder against other processes."""
        return locked(self.root / ".records.lock", RECORDS_LOCK_TIMEOUT_S)

    def _places(self) -> list[Path]:
        return [self.root, *(place for below in PLACES for place in self.root.glob(below))]

    def require_new(self) -> None:
        """Refuse a folder that contains files, but no record of the stage."""
        if present(self.record_path) or not present(self.root):
            return
        if not self.root.is_dir() or any(p.name[0] != "." for p in self.root.iterdir()):
            raise OutputError(self.root, "contains other files", "a new or empty folder")

    def write(self, path: Path, content: bytes, *, durable: bool = False) -> None:
        """Write a file of the folder atomically, and list it."""
        listed = partial(self._list, path, durable=durable)
        with writing(path, durable=durable, before_rename=listed) as file:
            file.write(content)

    def adopt(self, written: Path, path: Path) -> None:
        """Give a complete file or folder its name, in the place of an earlier one; list its files.

        An earlier one with a foreign file is refused, and stays.
        """
        earlier = files_at(path)
        self.refuse_foreign(earlier)
        self.remove_written(earlier)
        if is_folder(path):
            path.rmdir()
        for file in files_at(written):
            self._list(path / file.relative_to(written), file.stat())
        written.rename(path)

    def write_missing(self, path: Path, content: bytes) -> None:
        """Write a file of the folder unless it exists, since it may be edited."""
        if not filled(path):
            self.write(path, content)

    def replace(self, files: Mapping[Path, bytes], absent: Iterable[Path] = ()) -> None:
        """Replace files durably, and remove the absent ones; refuse foreign files."""
        absent = list(absent)
        with self.locked_records():
            sweep_stale(self.root)
            self.refuse_foreign([*files, *absent])
            self.remove_written(absent)
            for path, content in files.items():
                self.write(path, content, durable=True)

    def foreign_files(self, paths: Iterable[Path], states: States | None = None) -> list[Path]:
        """Return the foreign files among some paths; `states`: as of `states()`."""
        there = {path: path.lstat() for path in paths if os.path.lexists(path)}
        if states is None:
            states = self.states() if there else {}

        def is_written(path: Path, status: os.stat_result) -> bool:
            # A power cut may leave an empty file.
            listed = (status.st_size, status.st_mtime_ns) in states.get(path, ())
            return (listed or status.st_size == 0) and not self._behind_link(path)

        return [path for path, status in there.items() if not is_written(path, status)]

    def refuse_foreign(self, paths: Iterable[Path]) -> None:
        """Raise an error if a path is a foreign file."""
        if foreign := self.foreign_files(paths):
            raise foreign_file(foreign[0])

    def remove_written(self, paths: Iterable[Path]) -> list[Path]:
        """Remove the files among some paths that are not foreign; log and return the others."""
        paths = list(paths)
        foreign = self.foreign_files(paths)
        for path in {*paths} - {*foreign}:
            if path.is_dir():
                continue
            try:
                path.unlink(missing_ok=True)
            except OSError as error:
                raise refusal(path, error) from error
        if foreign:
            text = "not removed, because changed or not written by salsanext: %s"
            log.warning(text, first_few(foreign))
        return foreign

    def remove_records(self, names: Iterable[str]) -> None:
        """Remove records of the stage by name, which no list contains."""
        for name in names:
            (self.root / name).unlink(missing_ok=True)

    def written(self) -> list[Path]:
        """Return every listed file that exists, whether foreign or not, sorted."""
        return sorted(path for path in self.states() if os.path.lexists(path))

    def states(self) -> States:
        """Read the lists of written files."""
        states: States = {}
        for listing in sorted((self.root / FILE_LISTS).glob("*.tsv")):
            with reading(listing) as file:
                # Truncated lines are skipped.
                lines = [match for line in file if (match := LINE.fullmatch(line.rstrip()))]
            for name, size, time_ns in (line.groups() for line in lines):
                below = Path(os.fsdecode(unquote_to_bytes(name)))
                # A list from elsewhere must not name files outside the folder.
                if not below.is_absolute() and ".." not in below.parts:
                    state = int(size), int(time_ns)
                    states.setdefault(self.root / below, set()).add(state)
        return states

    def findings(self) -> dict[str, list[Texts]]:
        """Return the recorded warnings of all runs of the stage, by name of the scan."""
        recorded = read_record(_Findings, self._findings_path)
        return recorded.scans if recorded else {}

    def record_findings(
        self, findings: Mapping[str, list[Texts]], checked: Collection[str]
    ) -> dict[str, list[Texts]]:
        """Record warnings of checked scans by name; return earlier ones of the other scans."""
        with self.locked_records():
            earlier = {name: t for name, t in self.findings().items() if name not in checked}
            if present(self._findings_path) or findings:
                scans = earlier | {name: sorted(texts) for name, texts in findings.items()}
                record = _Findings(stage=self.stage, scans=dict(sorted(scans.items())))
                write_json(self._findings_path, record)
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


def files_at(path: Path) -> list[Path]:
    """Return a path that is no folder, else the files in it, also those in its subfolders."""
    if not is_folder(path):
        return [path]
    return [file for file in sorted(path.rglob("*")) if not is_folder(file)]


def foreign_file(path: Path) -> OutputError:
    """Return the error of a foreign file that would be replaced."""
    problem = "is a link" if path.is_symlink() else "was changed, or not written by salsanext"
    return OutputError(path, problem, hint="move it, or use another output folder")
