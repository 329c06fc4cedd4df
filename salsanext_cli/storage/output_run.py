# SPDX-License-Identifier: MIT
"""Taking an output folder for a run of a stage, so that no two runs mix or lose results."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from salsanext_cli.errors import OutputError
from salsanext_cli.storage.atomic import refusal, sweep_stale
from salsanext_cli.storage.json_files import write_json
from salsanext_cli.storage.layout import ScanFile, find_outputs
from salsanext_cli.storage.locks import Held, locked
from salsanext_cli.storage.sources import new_sources
from salsanext_cli.storage.stage_records import (
    as_json,
    manifest_of,
    owner,
    record,
    require_same_settings,
)

PATIENCE = 1800.0
"""Seconds to wait while others record what they do: a moment each, seconds if it is a million
scans, and there may be a hundred of them."""


@contextmanager
def claimed(
    out: Path,
    stage: str,
    settings: Mapping[str, Any],
    writes: Iterable[str],
    scans: Sequence[ScanFile] = (),
    *,
    overwrite: bool,
) -> Iterator[None]:
    """Record what a stage does in `OUT/<stage>.json`, or refuse to mix results.

    While the body runs, other runs with the same settings may work beside it, and none with
    others may remove its results.

    Parameters
    ----------
    out : Path
        The output folder.
    stage : str
        Its name on the command line.
    settings : mapping
        Resolved settings, JSON-able, that decide what the results are.
    writes : iterable of str
        The folders of results that the stage fills.
    scans : sequence of ScanFile
        What it works on; that, and where they came from, is remembered for later stages.
    overwrite : bool
        Whether other settings may replace those recorded; results made with them are removed.

    Raises
    ------
    OutputError
        If the folder holds results of other settings, or of another stage, and `overwrite` is
        not set, or another run is making them now; if a sequence of the same name came from
        elsewhere; or if it cannot be written. At the end, if it was removed meanwhile.
    """
    # What is wrong with the scans themselves is said before a folder is made.
    nothing_new = not new_sources(out, scans, stage)
    folders, settings = sorted(writes), as_json(settings)
    with ExitStack() as run:
        if nothing_new and _is_recorded(out, stage, settings, folders):
            run.enter_context(locked(_lock(out, stage), shared=True, patience=PATIENCE))
        if not (nothing_new and _is_recorded(out, stage, settings, folders)):
            run.close()
            with recording(out):
                _claim(out, stage, settings, folders, scans, overwrite)
                run.enter_context(locked(_lock(out, stage), shared=True, patience=PATIENCE))
        _sweep(out, folders, scans)
        yield
        _require_kept(out, stage, settings)


@contextmanager
def recording(out: Path) -> Iterator[None]:
    """Let nobody else read or write the records of an output folder while the body does."""
    with locked(out / ".records.lock", patience=PATIENCE):
        yield


@contextmanager
def alone(out: Path, stage: str) -> Iterator[None]:
    """Refuse while a run of a stage fills an output folder, and keep others from beginning one.

    Raises
    ------
    OutputError
        If there is such a run.
    """
    with ExitStack() as held:
        try:
            held.enter_context(locked(_lock(out, stage)))
        except Held as error:
            raise OutputError(
                out,
                f"another run of `{stage}` is at work in it",
                remedy="wait until it has ended, or use another folder",
            ) from error
        yield


def _lock(out: Path, stage: str) -> Path:
    return out / f".{stage}.lock"


def _claim(
    out: Path,
    stage: str,
    settings: Mapping[str, Any],
    folders: list[str],
    scans: Sequence[ScanFile],
    overwrite: bool,
) -> None:
    manifest = manifest_of(out, stage) or {}
    recorded = manifest.get("settings", settings)
    sources = new_sources(out, scans, stage, anew=recorded != settings)
    if recorded == settings:
        folders = sorted({*folders, *manifest.get("writes", ())})
    else:
        if not overwrite:
            require_same_settings(out / f"{stage}.json", recorded, settings)
        _remove_results(out, stage, manifest["writes"])
    for folder in folders:
        _take_over(out, folder, stage, overwrite)
        if not manifest and owner(out, folder) is None:
            if not overwrite:
                _require_none(out, folder)
            _remove_results(out, stage, [folder])
    # The manifest comes last: without it, a run that was killed before begins anew.
    for path, source in sources.items():
        write_json(path, source)
    record(out, stage, settings, folders)


def _is_recorded(out: Path, stage: str, settings: object, folders: list[str]) -> bool:
    """Whether another run with the same settings has recorded all there is to record."""
    manifest = manifest_of(out, stage) or {}
    return manifest.get("settings") == settings and {*folders} <= {*manifest["writes"]}


def _require_kept(out: Path, stage: str, settings: Mapping[str, Any]) -> None:
    """Say so if somebody has removed the folder, and results with it, while it was filled."""
    if (manifest_of(out, stage) or {}).get("settings") != settings:
        raise OutputError(
            out,
            "was removed or replaced while results were written into it",
            remedy="run again with --overwrite",
        )


def _take_over(out: Path, folder: str, stage: str, overwrite: bool) -> None:
    other = owner(out, folder)
    if other is None or other == stage:
        return
    path = out / f"{other}.json"
    if not overwrite:
        raise OutputError(
            path,
            f"{folder}/ holds the results of `{other}`",
            remedy="use another output folder, or --overwrite to replace them",
        )
    _remove_results(out, other, [folder])
    manifest = manifest_of(out, other) or {}
    write_json(path, manifest | {"writes": [name for name in manifest["writes"] if name != folder]})


def _require_none(out: Path, folder: str) -> None:
    """Refuse results that no stage of ours recorded: nobody knows how they were made."""
    if found := find_outputs(out, folder):
        raise OutputError(
            found[0].path,
            "was there before, made nobody knows how",
            remedy="use another output folder, or --overwrite to replace it",
        )


def _remove_results(out: Path, stage: str, folders: Iterable[str]) -> None:
    """Remove what a stage made with settings that no longer hold: only files that stages write."""
    with alone(out, stage):
        for folder in folders:
            for result in find_outputs(out, folder):
                _remove(result.path)


def _remove(path: Path) -> None:
    # A folder of that name is not ours; who wants to write there will name it.
    if path.is_dir() and not path.is_symlink():
        return
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise refusal(path, error) from error


def _sweep(out: Path, folders: Sequence[str], scans: Sequence[ScanFile]) -> None:
    """Remove what runs that were killed long ago left half written."""
    sequences = [out / "sequences" / name for name in sorted({scan.sequence for scan in scans})]
    for place in (out, *sequences, *(s / folder for s in sequences for folder in folders)):
        sweep_stale(place)
