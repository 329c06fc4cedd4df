# SPDX-License-Identifier: MIT
"""Stage `fuse`: labels of the scans of a drive by all scans that see the same locations."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path

from salsanext_cli.commands.jobs.fuse_task import FuseTask
from salsanext_cli.commands.jobs.plans.prepared_run import PreparedRun
from salsanext_cli.commands.jobs.plans.run_plan import RunPlan
from salsanext_cli.core.errors import SalsanextError, UsageError
from salsanext_cli.core.fusion.drive import Drive
from salsanext_cli.core.fusion.reach import FusionReach
from salsanext_cli.core.fusion.window import warn_without_movable_classes
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.optional_packages import import_extra
from salsanext_cli.core.wording import setting
from salsanext_cli.runs.drives.by_sequence import by_sequence
from salsanext_cli.runs.drives.drive_of_run import drive_of_run, foresee_drive
from salsanext_cli.runs.drives.earlier_fusion import other_scans
from salsanext_cli.runs.drives.fusible_results import FusibleResults, fusible_results, sequences_of
from salsanext_cli.runs.drives.scans_of_drive import drive_findings
from salsanext_cli.runs.drives.voting_places import MovedFolder, VotingPlaces, voting_places
from salsanext_cli.runs.fit.pose_files import poses_beside, readings_of
from salsanext_cli.runs.loop.run import Outcome, RunOptions, run_over_scans
from salsanext_cli.runs.results.folder_names import DISAGREEMENT, FUSED
from salsanext_cli.runs.results.output_run import OutputRun
from salsanext_cli.runs.results.query import ResultQuery
from salsanext_cli.runs.scans.scan_file import ScanFile, drive_order
from salsanext_cli.runs.scans.selection import scans_of
from salsanext_cli.runs.summary.recorded_summary import recorded_summary
from salsanext_cli.runs.summary.run_summary import RunSummary

FOLDERS_OF_VOTES = (DISAGREEMENT, "views")
FOLDERS_OF_LABELS = (*FOLDERS_OF_VOTES, "predictions")

log = logging.getLogger(__name__)


def fuse_results(
    out: Path,
    target: Path | None = None,
    *,
    poses: Path | None = None,
    reach: FusionReach = FusionReach(),
    query: ResultQuery = ResultQuery(),
    options: RunOptions = RunOptions(),
) -> Outcome:
    """Fuse the predicted labels of drives; write the disagreement with both kinds of labels.

    Parameters
    ----------
    out : Path
        Folder with labels and softmax of single scans.
    target : Path, optional
        Folder for the fused labels, `OUT/fused` by default.
    poses : Path, optional
        Poses of the one sequence; by default those in its folder, else they are computed.
    reach : FusionReach
        Scans that vote.
    query : ResultQuery, optional
        Choice of the scans, their data set and classes.
    options : RunOptions, optional
        Workers, progress, and treatment of failures and of existing results.

    Returns
    -------
    Outcome
    """
    prepared = _prepared(out, target, poses=poses, reach=reach, query=query, options=options)
    fusible = prepared.fusible
    drives_by_poses = prepared.drives_by_poses
    stop = options.on_error == "stop"
    summary = RunSummary(sensor=fusible.sensor, space=fusible.space, scans=fusible.scans)
    votes = prepared.votes.opened()
    labels = prepared.labels.opened()
    with (
        votes as single_run,
        labels as fused_run,
        recorded_summary(summary, fused_run, fusible.scans),
    ):

        def drive_of(name: str) -> Drive:
            files = fusible.members[name]
            return drive_of_run(files, drives_by_poses[name], single_run, fused_run, fusible.sensor)

        drives = by_sequence(drives_by_poses, drive_of, stop=stop)

        def is_done(file: ScanFile) -> bool:
            has_drive = isinstance(drives[file.sequence], Drive)
            return has_drive and single_run.is_done(file) and fused_run.is_done(file)

        for name, drive in drives.items():
            if isinstance(drive, Drive):
                summary.add_sequence(name, drive_findings(fusible.members[name], drive))
        task = FuseTask(
            members=fusible.members,
            drives=drives,
            space=fusible.space,
            sensor=fusible.sensor,
            reach=reach,
            single_run=single_run,
            fused_run=fused_run,
        )
        outcome = run_over_scans(
            task,
            fusible.scans,
            options,
            is_done=is_done,
            summary=summary,
            writes=[out, prepared.labels.out],
        )
    return replace(outcome, missing=fusible.missing)


def plan_fusion(
    out: Path,
    target: Path | None = None,
    *,
    poses: Path | None = None,
    reach: FusionReach = FusionReach(),
    query: ResultQuery = ResultQuery(),
    options: RunOptions = RunOptions(),
) -> RunPlan:
    """Return what `fuse_results` would do with the same arguments; write nothing.

    Parameters
    ----------
    out, target, poses, reach, query, options
        As for `fuse_results`.

    Returns
    -------
    RunPlan

    Raises
    ------
    SalsanextError
        What the run would refuse before it computes the poses of a drive.
    """
    prepared = _prepared(out, target, poses=poses, reach=reach, query=query, options=options)
    fusible = prepared.fusible
    single = prepared.votes.foreseen()
    fused = prepared.labels.foreseen()

    def is_unchanged(name: str) -> bool:
        drive = prepared.drives_by_poses[name]
        return foresee_drive(fusible.members[name], drive, single, fused)

    unchanged = by_sequence(prepared.drives_by_poses, is_unchanged, stop=options.on_error == "stop")

    def is_done(file: ScanFile) -> bool:
        return unchanged[file.sequence] is True and single.is_done(file) and fused.is_done(file)

    for name, error in unchanged.items():
        if isinstance(error, SalsanextError):
            log.error("sequence %s: %s", name, error)
    plan = RunPlan.from_scans(prepared.votes.listed, fusible.scans, options.shard, is_done)
    folders = (*prepared.votes.folders, *prepared.labels.folders)
    sized = plan.with_results(fusible.scans, folders, fusible.sensor)
    return replace(sized, missing=fusible.missing)


@dataclass(frozen=True, slots=True, kw_only=True)
class PreparedFusion:
    """Fusion before its first scan."""

    fusible: FusibleResults
    # As of `FusibleResults`, of the sequences of the shard
    drives_by_poses: Mapping[str, Drive | SalsanextError | None]
    votes: PreparedRun  # Writes beside the labels of single scans
    labels: PreparedRun  # Writes the fused labels


def _prepared(
    out: Path,
    target: Path | None,
    *,
    poses: Path | None,
    reach: FusionReach,
    query: ResultQuery,
    options: RunOptions,
) -> PreparedFusion:
    """Find the scans that can be fused, and their poses; arguments as of `fuse_results`."""
    target = target or out / FUSED
    if target.resolve() == out.resolve():
        raise UsageError("TARGET", f"{target} has the labels of single scans", "another folder")
    fusible = fusible_results(out, query)
    warn_without_movable_classes(fusible.space)  # Here, not in each worker
    stop = options.on_error == "stop"
    # Other shards compute the drives of their sequences.
    sequences = sequences_of(options.shard.select(fusible.scans))
    # All scans of a drive vote, not only the selected ones.
    voting = [file for name in fusible.sequences for file in fusible.members[name]]
    written = _written(fusible, out, target, options)
    places = {
        folder: voting_places(folder, voting, written, overwrite=options.overwrite)
        for folder in (out, target)
    }
    for folder, places_of_folder in places.items():
        if places_of_folder.other is not None:
            raise other_scans(folder, places_of_folder.other, out, target, query)
    _log_moves(places)
    return PreparedFusion(
        fusible=fusible,
        drives_by_poses=fusible.drives_by_poses(sequences, poses, stop=stop),
        votes=PreparedRun(
            out=out,
            stage="fuse",
            listed=fusible.listed,
            scans=fusible.scans,
            recorded=fusible.settings_of_votes(reach),
            folders=FOLDERS_OF_VOTES,
            overwrite=options.overwrite,
            records_scans=places[out].are_recorded,
            moved=places[out].moved,
        ),
        labels=PreparedRun(
            out=target,
            stage="fuse",
            listed=fusible.listed,
            scans=fusible.scans,
            recorded=fusible.settings_of_labels(reach, target),
            folders=FOLDERS_OF_LABELS,
            overwrite=options.overwrite,
            records_scans=places[target].are_recorded,
            moved=places[target].moved,
        ),
    )


def _written(
    fusible: FusibleResults, out: Path, target: Path, options: RunOptions
) -> list[ScanFile]:
    """Return the scans of the shard whose votes the run writes."""
    overwrite = options.overwrite
    votes = OutputRun(out, "fuse", folders=FOLDERS_OF_VOTES, overwrite=overwrite)
    labels = OutputRun(target, "fuse", folders=FOLDERS_OF_LABELS, overwrite=overwrite)
    scans = options.shard.select(fusible.scans)
    return [scan for scan in scans if not (votes.is_done(scan) and labels.is_done(scan))]


def _log_moves(places: Mapping[Path, VotingPlaces]) -> None:
    """Print where moved scans of folders of results are; each move once."""
    logged: set[MovedFolder] = set()
    for folder, places_of_folder in places.items():
        for move in places_of_folder.moves:
            if move not in logged:
                text = "%s: scans of %s, which are no longer there, are taken from %s"
                log.log(NOTICE, text, folder, move.before, move.now)
            logged.add(move)


def require_fusable(source: Path | Sequence[Path], out: Path, options: RunOptions) -> None:
    """Check before a prediction that its results can be fused.

    Parameters
    ----------
    source : Path or sequence of Path
        Scans to predict.
    out : Path
        Output folder for the hint.
    options : RunOptions
        Options of the run.

    Raises
    ------
    SalsanextError
        For a share of the scans, and if no sequence has usable poses or the package for them.
    """
    if options.shard.count > 1:
        hint = f"run `salsanext fuse {out}` when all shares are predicted"
        subject = setting("extras", ("votes",))
        raise UsageError(subject, "is not possible for a share of the scans", hint=hint)
    sequences = {
        name: sorted(group, key=drive_order)
        for name, group in groupby(scans_of(source), lambda file: file.sequence)
    }

    def require(name: str) -> None:
        poses = poses_beside(sequences[name])
        if poses is None:
            import_extra("small_gicp", "fuse")
        else:
            readings_of(poses, sequences[name])

    for error in by_sequence(sequences, require, stop=options.on_error == "stop").values():
        if error is not None:
            log.error("%s", error)
