# SPDX-License-Identifier: MIT
"""Stage `filter`: scans in their format, without the points of some classes."""

import logging
from collections.abc import Collection
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from salsanext_cli.commands.jobs.point_filter import FilterSettings, PointFilter, WrittenScan
from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.classes.merging import MOVABLE, named_classes
from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.measures.filtered_points import FilteredPoints
from salsanext_cli.core.texts import counted, first_few, with_hint
from salsanext_cli.core.wording import argument, command, setting
from salsanext_cli.io.formats.recordings import recording_of
from salsanext_cli.runs.loop.run import Outcome, RunOptions, run_over_scans
from salsanext_cli.runs.results.manifest import StageRecord, require_same_settings, settings_json
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.runs.results.paths import ERROR, PREDICTION_STAGES, ScanFile, with_outputs
from salsanext_cli.runs.results.query import ResultQuery
from salsanext_cli.runs.results.result_folder import ChosenResults, ResultFolder

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class FilterOutcome(Outcome):
    """Numbers of a filter."""

    filtered_points: FilteredPoints  # Numbers of points of the scans of this run


def filter_scans(
    out: Path,
    folder: Path,
    *,
    drop: Collection[str] = (),
    keep: Collection[str] = (),
    max_error: float | None = None,
    query: ResultQuery = ResultQuery(),
    options: RunOptions = RunOptions(),
) -> FilterOutcome:
    """Write scans in their format, without some of their points, to `FOLDER/sequences/<seq>/`.

    Parameters
    ----------
    out : Path
        Folder with the labels.
    folder : Path
        Folder for the scans.
    drop : collection of str
        Classes that are removed, as of `named_classes`.
    keep : collection of str
        Classes that alone remain, as of `named_classes`; by default all.
    max_error : float, optional
        Largest probability of error of the remaining points; points without one are dropped.
    query : ResultQuery, optional
        Choice of the scans, their data set and classes.
    options : RunOptions, optional
        Workers, progress, and treatment of failures and of existing results.

    Returns
    -------
    FilterOutcome
    """
    task, chosen = _point_filter(out, folder, drop, keep, max_error, query)
    written = list[WrittenScan]()
    with ExitStack() as stack:
        with task.owned.locked_records():
            _begin(task.owned, task.settings, options.overwrite)
            stack.enter_context(task.owned.open(shared=True))
        paths = map(task.path, chosen.scans)
        task = replace(task, foreign=frozenset(task.owned.foreign_files(paths)))
        outcome = run_over_scans(
            task.write, chosen.scans, options, is_done=task.is_done, on_result=written.append
        )
    total = sum((scan.counts for scan in written), FilteredPoints())
    empty = sorted(scan.name for scan in written if not scan.counts.remaining)
    if empty:
        log.warning("no point remains of %s: %s", counted(len(empty), "scan"), first_few(empty))
    if drop and total.rejected:
        log.warning("%s", _warning_of_rejected(total.rejected, drop, task.space))
    return FilterOutcome.from_run(outcome, missing=chosen.missing, filtered_points=total)


def _warning_of_rejected(count: int, drop: Collection[str], space: LabelSpace) -> str:
    """Return the warning about remaining points whose label was rejected."""
    points = f"{count:,} points remain although their"
    if count == 1:
        points = "1 point remains although its"
    rejecting = command("predict", argument("reject"))
    problem = f"{points} class is unknown: `{rejecting}` rejected the label"
    classes = tuple(dict.fromkeys([*drop, space.names[0]]))
    drop_too = command("to drop them too:", setting("drop", classes), setting("overwrite", True))
    without = f"filter results of `predict` without {argument('reject')}"
    return with_hint(problem, f"{drop_too}; to drop them by their class, {without}")


def _point_filter(
    out: Path,
    folder: Path,
    drop: Collection[str],
    keep: Collection[str],
    max_error: float | None,
    query: ResultQuery,
) -> tuple[PointFilter, ChosenResults]:
    """Return the filter of the options of `filter_scans`, and the chosen scans; refuse others."""
    _require_choice_of_points(drop, keep, max_error)
    results = ResultFolder(out, query.dataset)
    chosen = results.chosen(query)
    space = chosen.space
    selected = named_classes(keep or space.names, space) & ~named_classes(drop, space)
    if max_error is not None and not with_outputs(chosen.scans, out, ERROR):
        raise results.missing_column("error", chosen.scans[0])
    _require_files(chosen.scans[0])
    settings = FilterSettings(
        results=str(out.absolute()),
        classes=tuple(np.array(space.names)[selected].tolist()),
        measured_only=MOVABLE in drop or None,
        max_error=max_error,
        with_error_only=True if max_error is not None else None,
        label_space=space,
        origins=results.manifest.origins(PREDICTION_STAGES),
    )
    point_filter = PointFilter(
        results=results,
        owned=OwnedFolder(folder, "filter"),
        settings=settings,
        space=space,
        selected=selected,
        sensor=results.manifest.sensor(),
    )
    return point_filter, chosen


def _require_choice_of_points(
    drop: Collection[str], keep: Collection[str], max_error: float | None
) -> None:
    """Refuse a filter that would leave all points, and an impossible probability of error."""
    if not drop and not keep and max_error is None:
        expected = f"{argument('drop')}, {argument('keep')} or {argument('max_error')}"
        raise UsageError("filter", "no points to drop", expected)
    if max_error is not None and not 0 <= max_error <= 1:
        raise UsageError(argument("max_error"), f"{max_error:g}", "a probability from 0 to 1")


def _require_files(scan: ScanFile) -> None:
    """Refuse scans in a recording."""
    recording = recording_of(scan.path)
    if recording:
        hint = f"run `salsanext convert {recording} DATA`, then predict and filter DATA"
        problem = "is a recording, which `filter` cannot write"
        raise UsageError(recording, problem, "files of scans", hint)


def _begin(owned: OwnedFolder, settings: FilterSettings, overwrite: bool) -> None:
    """Record the settings in a new folder, or one with the same settings unless overwriting."""
    record = StageRecord(stage=owned.stage, settings=settings_json(settings))
    earlier = owned.manifest.record(owned.stage)
    if earlier is None:
        owned.require_new()
    elif not earlier.has_settings(record.settings):
        outdated = [path for path in owned.written() if path != owned.record_path]
        if outdated and not overwrite:
            require_same_settings(owned.record_path, earlier.settings, record.settings)
        if owned.is_shared():
            raise owned.busy()
        owned.remove_written(outdated)
    owned.manifest.write(record)
