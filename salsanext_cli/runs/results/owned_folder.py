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
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from urllib.parse import quote_from_bytes, unquote_to_bytes
from uuid import uuid4

from salsanext_cli.core.checks.finding import Finding
from salsanext_cli.core.errors import OutputError
from salsanext_cli.core.texts import first_few
from salsanext_cli.io.files.atomic import (
    MARK,
    append_line,
    make_durable,
    refusal,
    sweep,
    sweep_stale,
    writing,
)
from salsanext_cli.io.files.json_files import read_record, write_json
from salsanext_cli.io.files.locks import locked, remove_if_empty
from salsanext_cli.io.files.reading import filled, is_folder, present, reading
from salsanext_cli.runs.results.manifest import Manifest
from salsanext_cli.runs.scans.scan_folders import FILE_LISTS

SUBFOLDERS = (
    "sequences/*/",
    "sequences/*/*/",
    "sequences/*/*/*/",
    "folds/*/",
    "folds/*/events/",
    "events/",
    "eval/*/",
    "tools/*/",
    "tools/*/*/*/",
)
"""Patterns of the subfolders that stages write into."""
RECORDS_LOCK_TIMEOUT_S = 1800.0
"""A hundred other processes may hold the lock for seconds each in runs on a million scans."""
LINE = re.compile(rb"(?P<name>\S+)\t(?P<size>\d{1,19})\t(?P<time>\d{1,19})")
"""Line of a list of written files."""

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class FileState:
    """State of a file right after it was written."""

    size: int  # Bytes
    time_ns: int  # Time of modification

    @classmethod
    def from_status(cls, status: os.stat_result) -> "FileState":
        """Return the state of a file as the system reports it."""
        return cls(size=status.st_size, time_ns=status.st_mtime_ns)


States = dict[Path, set[FileState]]
"""State of each listed file at each writing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _RecordedFindings:
    """Warnings about the scans of all runs of a stage, as their file has them."""

    stage: str
    # Code, problem and hint of each finding, by name of the scan or sequence
    scans: dict[str, list[tuple[str, str, str]]]

    @classmethod
    def from_findings(
        cls, stage: str, findings: Mapping[str, Iterable[Finding]]
    ) -> "_RecordedFindings":
        """Return the record of findings by name, sorted."""
        scans = {
            name: [(finding.code, finding.problem, finding.hint) for finding in sorted(members)]
            for name, members in sorted(findings.items())
        }
        return cls(stage=stage, scans=scans)

    def findings(self) -> dict[str, list[Finding]]:
        """Return the findings by name of the scan or sequence."""
        return {
            name: [Finding(code, problem, hint) for code, problem, hint in rows]
            for name, rows in self.scans.items()
        }


@dataclass(frozen=True, slots=True)
class OwnedFolder:
    """Folder that a stage fills; small enough to be sent to other processes."""

    root: Path  # The folder may not exist yet
    stage: str = ""  # Name of the stage on the command line
    record_folder: str = ""  # Subfolder with lock and record, if it is not the root

    @property
    def manifest(self) -> Manifest:
        """Records of the stages that ran in the folder."""
        return Manifest(self.root / self.record_folder)

    @property
    def record_path(self) -> Path:
        """Path of the record of the stage."""
        return self.manifest.path(self.stage)

    @property
    def findings_path(self) -> Path:
        """Path of the recorded warnings of the stage."""
        return self.root / f"{self.stage}.warnings.json"

    @contextmanager
    def open(self, *, shared: bool = False) -> Iterator[None]:
        """Lock the folder against other runs of the stage, unless it is shared; sweep it."""
        mark = uuid4().hex
        # Temporary files of other threads of this process stay.
        token = MARK.set(mark)
        name = f".{self.stage}.{mark}.lock" if shared else f".{self.stage}.lock"
        try:
            folder = self.root / self.record_folder
            with remove_if_empty(folder), locked(folder / name, stage=self.stage):
                for place in self._folders():
                    sweep_stale(place)
                try:
                    yield
                finally:
                    for place in self._folders():
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

    def _folders(self) -> list[Path]:
        """Return the root and the existing subfolders that stages write into."""
        folders = [self.root]
        for pattern in SUBFOLDERS:
            folders += self.root.glob(pattern)
        return folders

    def require_new(self) -> None:
        """Refuse a folder that contains files, but no record of the stage."""
        if present(self.record_path) or not present(self.root):
            return
        is_file = not self.root.is_dir()
        if is_file or any(path.name[0] != "." for path in self.root.iterdir()):
            raise OutputError(self.root, "contains other files", "a new or empty folder")

    def write(self, path: Path, content: bytes, *, durable: bool = False) -> None:
        """Write a file of the folder atomically, and list it."""
        listed = partial(self._list, path, durable=durable)
        with writing(path, durable=durable, before_rename=listed) as file:
            file.write(content)

    def adopt(self, written: Path, path: Path) -> None:
        """Give a complete file or folder its name, in the place of an earlier one; list its files.

        Parameters
        ----------
        written : Path
            Complete file or folder, in a temporary folder of the same disk. An earlier folder is
            moved beside it, and the caller removes both with the temporary folder.
        path : Path
            Its name.

        Raises
        ------
        OutputError
            If the earlier one contains what salsanext did not write; then it stays.
        OSError
            If the system refuses to move them; then the earlier one stays, too.
        """
        # The list outlasts a power cut, after which a shorter file would be foreign.
        for file in files_at(written):
            make_durable(file)
        with self.locked_records():
            self.refuse_foreign_members(path)
            for file in files_at(written):
                # After a power cut, only the names of empty files show whose they are.
                self._list(path / file.relative_to(written), file.stat(), durable=True)
            if not is_folder(path):
                written.replace(path)
                return
            earlier = written.with_name(f"earlier-{path.name}")
            path.rename(earlier)
            try:
                written.rename(path)
            except BaseException:
                earlier.rename(path)
                raise

    def refuse_foreign_members(self, path: Path) -> None:
        """Refuse a file or folder with anything that salsanext did not write."""
        foreign = self.foreign_members(path)
        if foreign:
            raise foreign_file(foreign[0])

    def foreign_members(self, path: Path) -> list[Path]:
        """Return what salsanext did not write of a file or folder that is replaced as a whole.

        Users may have added folders, and files of any name. Therefore also an empty file is
        foreign if its name is not listed.
        """
        if path.is_symlink():
            return [path]
        states = self.states()
        members = sorted(path.rglob("*")) if is_folder(path) else [path]
        unlisted = {
            member
            for member in members
            if is_folder(member) or (member not in states and os.path.lexists(member))
        }
        unlisted.update(self.foreign_files(members, states))
        return sorted(unlisted)

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
        existing = {
            path: FileState.from_status(path.lstat()) for path in paths if os.path.lexists(path)
        }
        if not existing:
            return []
        if states is None:
            states = self.states()
        return [
            path
            for path, state in existing.items()
            if not self._is_written(path, state, states.get(path, set()))
        ]

    def _is_written(self, path: Path, state: FileState, listed: Collection[FileState]) -> bool:
        """Return whether a file is one of the listed ones; a power cut may leave an empty one."""
        return (state in listed or state.size == 0) and not self._behind_link(path)

    def refuse_foreign(self, paths: Iterable[Path]) -> None:
        """Raise an error if a path is a foreign file."""
        foreign = self.foreign_files(paths)
        if foreign:
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
                matches = [LINE.fullmatch(line.rstrip()) for line in file]
            for match in matches:
                if match is None:
                    continue  # The line was cut off.
                below = Path(os.fsdecode(unquote_to_bytes(match["name"])))
                # A list from elsewhere must not name files outside the folder.
                if not below.is_absolute() and ".." not in below.parts:
                    state = FileState(size=int(match["size"]), time_ns=int(match["time"]))
                    states.setdefault(self.root / below, set()).add(state)
        return states

    def findings(self) -> dict[str, list[Finding]]:
        """Return the recorded warnings of all runs of the stage, by name of the scan."""
        recorded = read_record(_RecordedFindings, self.findings_path)
        return recorded.findings() if recorded else {}

    def record_findings(
        self, findings: Mapping[str, Sequence[Finding]], checked: Collection[str]
    ) -> dict[str, list[Finding]]:
        """Record warnings about scans, and return the earlier ones about scans not checked now.

        Parameters
        ----------
        findings : mapping of str to sequence of Finding
            Warnings by name of the scan or sequence.
        checked : collection of str
            Names of all scans and sequences that were checked, whose earlier warnings go.

        Returns
        -------
        dict of str to list of Finding
        """
        with self.locked_records():
            earlier = {
                name: recorded for name, recorded in self.findings().items() if name not in checked
            }
            if present(self.findings_path) or findings:
                record = _RecordedFindings.from_findings(self.stage, {**earlier, **findings})
                write_json(self.findings_path, record)
        return earlier

    def _behind_link(self, path: Path) -> bool:
        """Return whether a path, or a folder between it and the root, is a link."""
        folders = path.relative_to(self.root).parents[:-1]
        return path.is_symlink() or any((self.root / folder).is_symlink() for folder in folders)

    def _list(self, path: Path, status: os.stat_result, *, durable: bool = False) -> None:
        """Append a file of a status to the list of this machine."""
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
