# SPDX-License-Identifier: MIT
"""Stage `filter`: scans in their format, and bags, without the points of some classes."""

import logging
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from salsanext_cli.commands.jobs.plans.run_plan import RunPlan
from salsanext_cli.commands.jobs.point_filter import FilterSettings, PointFilter, WrittenScan
from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.classes.merging import MOVABLE, named_classes
from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.measures.filtered_points import FilteredPoints
from salsanext_cli.core.records import Origin
from salsanext_cli.core.texts import counted, first_few, with_hint
from salsanext_cli.core.wording import argument, command, setting
from salsanext_cli.io.files.reading import bytes_at
from salsanext_cli.io.formats.recording_kinds import kind_of
from salsanext_cli.io.formats.recordings import files_of, recording_of
from salsanext_cli.io.formats.ros.bag_copies import Types
from salsanext_cli.io.formats.ros.cloud_changes import cloud_subset
from salsanext_cli.runs.annotation.map_frames import (
    changed_frames,
    frames_beside,
    refuse_ignored_frames,
    write_frames,
)
from salsanext_cli.runs.copies.bag_run import BagOfResults, BagRun, bags_of, is_bag
from salsanext_cli.runs.copies.filled_folder import begin, foresee
from salsanext_cli.runs.loop.run import Failure, Outcome, RunOptions, run_over_scans
from salsanext_cli.runs.loop.run_options import Shard
from salsanext_cli.runs.results.folder_names import ERROR, PREDICTION_STAGES
from salsanext_cli.runs.results.output_paths import with_outputs
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.runs.results.query import ResultQuery
from salsanext_cli.runs.results.result_folder import ChosenResults, ResultFolder
from salsanext_cli.runs.scans.scan_file import ScanFile

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

    A bag is written to `FOLDER/<seq>.bag` (ROS 1) or `FOLDER/<seq>/` (ROS 2), with all other
    messages.

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
    prepared = _prepared(out, folder, drop, keep, max_error, query, options.shard)
    task = prepared.task
    chosen = prepared.chosen
    bags = prepared.bags
    written: dict[ScanFile, FilteredPoints] = {}
    with begin(task.owned, task.settings, options.overwrite):
        if bags:
            outcome = _filter_bags(task, bags, options, written)
        else:
            outcome = _filter_files(task, chosen.scans, prepared.frames, options, written)
    total = sum(written.values(), FilteredPoints())
    empty = [scan.name for scan, counts in sorted(written.items()) if not counts.remaining]
    if empty:
        log.warning("no point remains of %s: %s", counted(len(empty), "scan"), first_few(empty))
    if drop and total.rejected:
        log.warning("%s", _warning_of_rejected(total.rejected, drop, task.space))
    return FilterOutcome.from_run(outcome, missing=chosen.missing, filtered_points=total)


def plan_filter(
    out: Path,
    folder: Path,
    *,
    drop: Collection[str] = (),
    keep: Collection[str] = (),
    max_error: float | None = None,
    query: ResultQuery = ResultQuery(),
    options: RunOptions = RunOptions(),
) -> RunPlan:
    """Return what `filter_scans` would do with the same arguments; write nothing into `folder`.

    Parameters
    ----------
    out, folder, drop, keep, max_error, query, options
        As for `filter_scans`.

    Returns
    -------
    RunPlan
        The size is that of the files with all points.

    Raises
    ------
    SalsanextError
        What the run would refuse.
    """
    prepared = _prepared(out, folder, drop, keep, max_error, query, options.shard)
    task = prepared.task
    scans = prepared.chosen.scans
    listed = prepared.chosen.listed
    stays = foresee(task.owned, task.settings, options.overwrite) and not options.overwrite
    if prepared.bags:
        run = _bag_run(task, {})
        failures: list[Failure] = []
        to_copy = run.to_copy(prepared.bags, replace(options, overwrite=not stays), failures)
        for failure in failures:
            log.error("%s: %s", failure.scan.name, failure.text)
        todo = [cloud for clouds in to_copy.clouds.values() for cloud in clouds]
        # Clouds of a bag that fails are not known, and it is not done.
        todo += [failure.scan for failure in failures]
        plan = RunPlan(scans=len(listed), done=to_copy.done, todo=todo)
        files = [file for bag in to_copy.clouds for file in files_of(bag.path)]
    else:
        task = _with_foreign_files(task, scans)

        def is_done(scan: ScanFile) -> bool:
            return stays and scan not in prepared.moved and task.is_done(scan)

        plan = RunPlan.from_scans(listed, scans, options.shard, is_done)
        files = [scan.path for scan in plan.todo]
    size = sum(map(bytes_at, files))
    return replace(plan, missing=prepared.chosen.missing, size=size, is_limit=True)


def _filter_files(
    task: PointFilter,
    scans: Sequence[ScanFile],
    frames: Mapping[ScanFile, Origin],
    options: RunOptions,
    written: dict[ScanFile, FilteredPoints],
) -> Outcome:
    """Write files of scans without some points; add the numbers of their points to `written`.

    `frames`: frames of scans that were moved out of a map, metres.
    """
    task = _with_foreign_files(task, scans)
    with task.owned.locked_records():
        _update_frames(task, options.shard.select(scans), frames)

    def add(scan: WrittenScan) -> None:
        written[scan.file] = scan.counts

    return run_over_scans(
        task.write,
        scans,
        options,
        is_done=task.is_done,
        on_result=add,
        writes=[task.owned.root],
        reads=[task.results.root],
    )


def _with_foreign_files(task: PointFilter, scans: Sequence[ScanFile]) -> PointFilter:
    """Return a filter with the files that are not as salsanext wrote them."""
    paths = map(task.path, scans)
    return replace(task, foreign=frozenset(task.owned.foreign_files(paths)))


def _update_frames(
    task: PointFilter, scans: Sequence[ScanFile], frames: Mapping[ScanFile, Origin]
) -> None:
    """Write the frames of scans, and remove their outdated files, which are in other frames.

    This comes before the first scan, so that an interrupted run leaves none without its frame.
    `scans`: those of this shard; another one writes the others again, with their frames.
    """
    changed = changed_frames(task.owned, scans, frames)
    outdated = {task.path(scan) for change in changed for scan in change.scans}
    task.owned.remove_written(outdated - task.foreign)
    write_frames(task.owned, changed)


def _filter_bags(
    task: PointFilter,
    bags: Sequence[BagOfResults],
    options: RunOptions,
    written: dict[ScanFile, FilteredPoints],
) -> Outcome:
    """Write bags without some points; add the numbers of their points to `written`."""
    outcome = _bag_run(task, written).run(bags, options)
    failed = {failure.scan.sequence for failure in outcome.failures}
    for file in [file for file in written if file.sequence in failed]:
        del written[file]
    return outcome


def _bag_run(task: PointFilter, written: dict[ScanFile, FilteredPoints]) -> BagRun:
    """Return the run that filters bags; it adds the numbers of their points to `written`."""

    def new_cloud(file: ScanFile, message: Any, _: Types) -> Any:
        filtered = task.filtered_cloud(file)
        written[file] = filtered.counts
        return cloud_subset(message, filtered.remains, file.path)

    return BagRun(
        results=task.results,
        owned=task.owned,
        new_topic=lambda bag, topic: topic,
        new_cloud=new_cloud,
    )


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


@dataclass(frozen=True, slots=True, kw_only=True)
class PreparedFilter:
    """Filter before its first scan."""

    task: PointFilter
    chosen: ChosenResults
    bags: Sequence[BagOfResults]  # Of the scans; none for scans in files
    # Of scans that were moved out of a map, metres; read before outdated files are removed
    frames: Mapping[ScanFile, Origin]
    moved: Collection[ScanFile]  # Scans of the shard whose frame is another than that of their copy


def _prepared(
    out: Path,
    folder: Path,
    drop: Collection[str],
    keep: Collection[str],
    max_error: float | None,
    query: ResultQuery,
    shard: Shard,
) -> PreparedFilter:
    """Choose scans and points; arguments as of `filter_scans`."""
    _require_choice_of_points(drop, keep, max_error)
    results = ResultFolder(out, query.dataset)
    chosen = results.chosen(query)
    space = chosen.space
    selected = named_classes(keep or space.names, space) & ~named_classes(drop, space)
    if max_error is not None and not with_outputs(chosen.scans, out, ERROR):
        raise results.missing_column("error", chosen.scans[0])
    settings = FilterSettings(
        results=str(out.absolute()),
        classes=tuple(np.array(space.names)[selected].tolist()),
        measured_only=MOVABLE in drop or None,
        max_error=max_error,
        with_error_only=True if max_error is not None else None,
        label_space=space,
        origins=results.provenance.origins(PREDICTION_STAGES),
    )
    point_filter = PointFilter(
        results=results,
        owned=OwnedFolder(folder, "filter"),
        settings=settings,
        space=space,
        selected=selected,
        sensor=results.provenance.sensor(),
    )
    bags = bags_of(chosen.scans)
    _require_one_kind(chosen.scans, bags, query)
    frames = frames_beside(chosen.scans)
    scans = [] if bags else shard.select(chosen.scans)
    changed = changed_frames(point_filter.owned, scans, frames)
    moved = {scan for change in changed for scan in change.scans}
    refuse_ignored_frames(moved)
    return PreparedFilter(task=point_filter, chosen=chosen, bags=bags, frames=frames, moved=moved)


def _require_choice_of_points(
    drop: Collection[str], keep: Collection[str], max_error: float | None
) -> None:
    """Refuse a filter that would leave all points, and an impossible probability of error."""
    if not drop and not keep and max_error is None:
        expected = f"{argument('drop')}, {argument('keep')} or {argument('max_error')}"
        raise UsageError("filter", "no points to drop", expected)
    if max_error is not None and not 0 <= max_error <= 1:
        raise UsageError(argument("max_error"), f"{max_error:g}", "a probability from 0 to 1")


def _require_one_kind(
    scans: Sequence[ScanFile], bags: Sequence[BagOfResults], query: ResultQuery
) -> None:
    """Refuse captures, E57 files, scans of bags beside others, and a limit on clouds of a bag."""
    recordings = {folder: recording_of(folder) for folder in {scan.path.parent for scan in scans}}
    for recording in recordings.values():
        if recording is not None and not is_bag(recording):
            hint = f"run `salsanext convert {recording} DATA`, then predict and filter DATA"
            problem = f"is {kind_of(recording).noun}, which `filter` cannot write"
            raise UsageError(recording, problem, "files of scans, or bags", hint)
    if bags and None in recordings.values():
        names = tuple(sorted({bag.first.sequence for bag in bags}))
        hint = f"filter the bags alone, with {setting('sequences', names)}"
        raise UsageError(bags[0].path, "is a bag, beside files of scans", "one of them", hint)
    if bags and query.selection.limit is not None:
        problem = "cannot be combined with bags, which are copied whole"
        raise UsageError(argument("limit"), problem, hint=f"omit {argument('limit')}")
