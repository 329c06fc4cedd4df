# SPDX-License-Identifier: MIT
"""Registration of a run in an output folder: its settings recorded, or the run refused."""

import logging
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

from salsanext_cli.errors import OutputError, first_few
from salsanext_cli.files.locks import locked
from salsanext_cli.results.layout import ERROR, find_outputs
from salsanext_cli.results.stage_records import (
    ScanSource,
    StageRecord,
    owner,
    read_record,
    require_same_settings,
)
from salsanext_cli.results.written_files import WrittenFiles

RECORDS_LOCK_TIMEOUT_S = 1800.0
"""Others hold the lock for a moment each, seconds if it is a million scans, and there may be a
hundred of them."""

log = logging.getLogger(__name__)


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
    """Remove results that salsanext wrote and that are unchanged; name and return the others."""
    found = [path for folder in folders for path in find_outputs(out, folder).values()]
    kept = WrittenFiles(out).remove(found)
    if kept:
        log.warning("kept, since changed or not written by salsanext: %s", first_few(kept))
    return kept
