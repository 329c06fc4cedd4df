# SPDX-License-Identifier: MIT
"""The run of a stage that fills an output folder: settings, lock, results there and missing."""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy.typing as npt

from salsanext_cli.classes.label_space import RawIds
from salsanext_cli.errors import OutputError
from salsanext_cli.files.atomic import MARK, sweep, sweep_stale
from salsanext_cli.files.json_files import read_json, write_json
from salsanext_cli.files.locks import locked
from salsanext_cli.files.reading import filled, present
from salsanext_cli.formats.labels import encode_labels
from salsanext_cli.formats.npy import encode_array
from salsanext_cli.results.layout import ERROR, ScanFile, find_outputs, output_path
from salsanext_cli.results.owned_folder import OwnedFolder, not_own
from salsanext_cli.results.sources import scan_sources
from salsanext_cli.results.stage_records import (
    ScanSource,
    StageRecord,
    as_json,
    owner,
    read_record,
    require_same_settings,
)

RECORDS_LOCK_TIMEOUT_S = 1800.0
"""Others hold the lock for a moment each, seconds if it is a million scans, and there may be a
hundred of them."""
Texts = tuple[str, str, str]
"""Code, message and remedy."""


@contextmanager
def records_lock(out: Path) -> Iterator[None]:
    """Let no other process read or write the records of an output folder while the body does."""
    with locked(out / ".records.lock", RECORDS_LOCK_TIMEOUT_S):
        yield


def register_run(wanted: StageRecord, out: Path, overwrite: bool) -> StageRecord:
    """Bring the records of a folder, and its results, to what a run wants, under `records_lock`.

    `wanted`: what the run would record; `out`: the output folder; `overwrite`: whether results of
    other settings or stages may be removed.
    """
    stage, recorded = wanted.stage, read_record(out, wanted.stage)
    before = recorded or StageRecord(stage, wanted.settings)
    same = before.settings == wanted.settings
    owners = {folder: owner(out, folder) for folder in wanted.folders}
    others = {folder: other for folder, other in owners.items() if other and other != stage}
    if not overwrite:
        require_same_settings(out / f"{stage}.json", before.settings, wanted.settings)
        for folder, other in others.items():
            raise OutputError(
                out / f"{other}.json",
                f"{folder}/ holds the results of `{other}`",
                remedy="use another output folder, or --overwrite to replace them",
            )
    kept: list[Path] = []
    with ExitStack() as held:
        for filler in [*([] if same else [stage]), *sorted({*others.values()})]:
            for lock in sorted(out.glob(f".{filler}.*.lock")):
                held.enter_context(locked(lock, stage=filler))
        # Nothing is removed before it is certain that the run may begin.
        if not same:
            kept += _remove_results(out, before.folders)
        for folder in wanted.folders:
            if folder in others:
                kept += _take_over(out, folder, others[folder])
            elif folder not in before.folders:
                kept += _remove_unrecorded(out, folder, overwrite)
    merged = replace(wanted, kept=frozenset(path.relative_to(out).as_posix() for path in kept))
    if same:
        merged = _merged(before, merged)
    # The record comes last: without it, a run that was killed before begins anew.
    if merged != recorded:
        merged.write(out)
    return merged


def _merged(recorded: StageRecord, wanted: StageRecord) -> StageRecord:
    """Return a record of what was done before with the same settings, and of what is wanted."""
    scans = dict(recorded.scans)
    for sequence, source in wanted.scans.items():
        before = scans[sequence].stems if sequence in scans else frozenset()
        scans[sequence] = ScanSource(source.folder, source.stems | before)
    folders = tuple(sorted({*recorded.folders, *wanted.folders}))
    return replace(wanted, folders=folders, scans=scans, kept=wanted.kept | recorded.kept)


def _take_over(out: Path, folder: str, other: str) -> list[Path]:
    """Remove the results of another stage from a folder, which is this stage's from now on.

    With its labels go the probabilities that these are wrong.
    """
    taken = [folder, ERROR] if folder == "predictions" else [folder]
    record = read_record(out, other)
    taken = [name for name in taken if name == folder or (record and name in record.folders)]
    kept = _remove_results(out, taken)
    if record:
        left = tuple(name for name in record.folders if name not in taken)
        replace(record, folders=left).write(out)
    return kept


def _remove_unrecorded(out: Path, folder: str, overwrite: bool) -> list[Path]:
    """Refuse results that no stage recorded, or remove them: it is not known how they were made."""
    if (found := find_outputs(out, folder)) and not overwrite:
        raise OutputError(
            next(iter(found.values())),
            "is a result that no stage recorded",
            remedy="use another output folder, or --overwrite to work beside it",
        )
    return _remove_results(out, [folder])


def _remove_results(out: Path, folders: Iterable[str]) -> list[Path]:
    """Remove results that are as salsanext wrote them; return the others."""
    found = [path for folder in folders for path in find_outputs(out, folder).values()]
    return OwnedFolder(out).remove_own(found)


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
                raise not_own(path)

    def write(self, file: ScanFile, folder: str, content: bytes) -> None:
        """Write a result of a scan whole or not at all, and record it."""
        OwnedFolder(self.out).write(self.path(file, folder), content)

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
        others = OwnedFolder(out).others
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


def keep_findings(
    out: Path, stage: str, found: Mapping[str, list[Texts]], looked_at: Collection[str]
) -> dict[str, list[Texts]]:
    """Keep what a run found in an output folder; return what earlier runs found of other scans.

    `out`: the output folder; `stage`: the stage; `found`: code, message and remedy of each finding,
    by the name of the scan; `looked_at`: names of all scans that the run has looked at; what
    earlier runs found of them is outdated.
    """
    path = _path(out, stage)
    with records_lock(out):
        known = read_findings(out, stage)
        earlier = {name: texts for name, texts in known.items() if name not in looked_at}
        if present(path) or found:
            everything = {**earlier, **{name: sorted(texts) for name, texts in found.items()}}
            write_json(path, {"stage": stage, "scans": dict(sorted(everything.items()))})
    return earlier


def read_findings(out: Path, stage: str) -> dict[str, list[Texts]]:
    """Return what the runs of a stage found, by the name of the scan; empty if none is kept."""
    known = read_json(_path(out, stage))
    scans = {} if known is None else known.get("scans")
    return {
        name: [tuple(texts) for texts in findings]
        for name, findings in (scans.items() if isinstance(scans, dict) else ())
        if _are_findings(findings)
    }


def _path(out: Path, stage: str) -> Path:
    return out / f"{stage}.warnings.json"


def _are_findings(value: object) -> bool:
    return isinstance(value, list) and all(
        isinstance(texts, list) and [*map(type, texts)] == [str, str, str] for texts in value
    )
