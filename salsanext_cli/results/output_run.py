# SPDX-License-Identifier: MIT
"""The run of a stage that fills an output folder: settings, lock, results there and missing."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy.typing as npt

from salsanext_cli.classes.label_space import RawIds
from salsanext_cli.errors import OutputError
from salsanext_cli.files.atomic import MARK, sweep, sweep_stale
from salsanext_cli.files.locks import locked
from salsanext_cli.files.reading import filled
from salsanext_cli.formats.labels import encode_labels
from salsanext_cli.formats.npy import encode_array
from salsanext_cli.results.layout import ScanFile, output_path
from salsanext_cli.results.run_registration import records_lock, register_run
from salsanext_cli.results.sources import scan_sources
from salsanext_cli.results.stage_records import StageRecord, as_json, read_record
from salsanext_cli.results.written_files import WrittenFiles


@dataclass(frozen=True, slots=True)
class OutputRun:
    """One run of a stage in an output folder; small enough to be sent to other processes."""

    out: Path
    folders: tuple[str, ...]  # Folders of results that a scan is given, keys of `SUFFIX_OF_FOLDER`
    overwrite: bool = False  # Whether results that are there are made again
    # Results that are there, but not as salsanext wrote them, of scans that lack a result or have
    # one of other settings: they are never replaced
    kept: frozenset[Path] = frozenset()

    def path(self, file: ScanFile, folder: str) -> Path:
        """Return where a result of a scan lies."""
        return output_path(self.out, file.sequence, folder, file.stem)

    def paths(self, file: ScanFile) -> list[Path]:
        """Return where all results of a scan lie."""
        return [self.path(file, folder) for folder in self.folders]

    def is_there(self, file: ScanFile) -> bool:
        """Say whether a scan has all its results."""
        return all(filled(path) and path not in self.kept for path in self.paths(file))

    def is_done(self, file: ScanFile) -> bool:
        """Say whether a scan has all its results, and they are not to be made again."""
        return not self.overwrite and self.is_there(file)

    def require_replaceable(self, file: ScanFile) -> None:
        """Raise `OutputError` if a result of a scan is there that salsanext did not write so."""
        for path in self.paths(file):
            if path in self.kept:
                found = "was changed, or not written by salsanext, and is kept"
                raise OutputError(path, found, remedy="move it, or use another output folder")

    def write(self, file: ScanFile, folder: str, content: bytes) -> None:
        """Write a result of a scan whole or not at all, and record it."""
        WrittenFiles(self.out).write(self.path(file, folder), content)

    def write_array(self, file: ScanFile, folder: str, array: npt.NDArray[Any]) -> None:
        """Write a result of a scan as a `.npy` file."""
        self.write(file, folder, encode_array(array))

    def write_labels(self, file: ScanFile, raw: RawIds) -> None:
        """Write the predicted raw ids of a scan's points, (N,) integer."""
        self.write(file, "predictions", encode_labels(raw))


@contextmanager
def output_run(
    out: Path,
    stage: str,
    settings: Mapping[str, Any],
    folders: Iterable[str],
    scans: Sequence[ScanFile],
    *,
    overwrite: bool,
    record_scans: bool = True,
) -> Iterator[OutputRun]:
    """Record what a stage does in `OUT/<stage>.json`, or refuse to mix results.

    While the body runs, other runs with the same settings may work beside it, and none with
    others may remove its results.

    `out`: the output folder; `stage`: its name on the command line; `settings`: resolved settings,
    JSON-able, that decide what the results are; `folders`: the folders of results that the stage
    fills; `scans`: what it works on; `overwrite`: whether other settings may replace those
    recorded; results made with them are removed, if salsanext wrote them and they are unchanged
    since; `record_scans`: whether to record where the scans lie and that they were asked for; not
    for a stage that works on what an earlier one recorded.
    """
    # A contradiction of the scans themselves is an error before a folder is made.
    sources = scan_sources(out, scans) if record_scans else {}
    wanted = StageRecord(stage, as_json(settings), tuple(sorted(folders)), sources)
    mark = uuid4().hex
    with ExitStack() as held:
        # Runs of other threads of this process keep their temporary files.
        held.callback(MARK.reset, MARK.set(mark))
        with records_lock(out):
            recorded = register_run(wanted, out, overwrite)
            for lock in out.glob(f".{stage}.*.lock"):
                # That of a killed run can be taken, and goes when it is released.
                with suppress(OutputError), locked(lock):
                    pass
            held.enter_context(locked(out / f".{stage}.{mark}.lock"))
        for place in _places(out, wanted.folders, scans):
            sweep_stale(place)
            held.callback(sweep, place, mark)
        others = WrittenFiles(out).others
        # First those of other settings: they are no results of this run.
        kept = frozenset(others(out / name for name in recorded.kept))
        run = OutputRun(out, tuple(folders), overwrite, kept)
        todo = [path for file in scans if not run.is_done(file) for path in run.paths(file)]
        yield replace(run, kept=frozenset(others(todo)))
        record = read_record(out, stage)
        if record is None or record.settings != wanted.settings:
            found = "was removed or replaced while results were written into it"
            raise OutputError(out, found, remedy="run again with --overwrite")


def _places(out: Path, folders: Iterable[str], scans: Iterable[ScanFile]) -> list[Path]:
    """Return every folder that the results of scans go to."""
    sequences = [out / "sequences" / name for name in sorted({scan.sequence for scan in scans})]
    return [out, *sequences, *(place / folder for place in sequences for folder in folders)]
