# SPDX-License-Identifier: MIT
"""Stage `fuse`: labels of the scans of a drive by all scans that see the same locations."""

import logging
from collections.abc import Sequence
from dataclasses import replace
from itertools import groupby
from pathlib import Path

from salsanext_cli.commands.jobs.fuse_task import FuseTask
from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.fusion.drive import Drive
from salsanext_cli.core.fusion.reach import FusionReach
from salsanext_cli.core.fusion.window import warn_without_movable_classes
from salsanext_cli.core.optional_packages import import_extra
from salsanext_cli.core.wording import setting
from salsanext_cli.runs.drives.by_sequence import by_sequence
from salsanext_cli.runs.drives.drive_of_run import drive_of_run
from salsanext_cli.runs.drives.fusible_results import fusible_results, sequences_of
from salsanext_cli.runs.drives.scans_of_drive import drive_findings
from salsanext_cli.runs.fit.pose_files import poses_beside, readings_of
from salsanext_cli.runs.loop.run import Outcome, RunOptions, run_over_scans
from salsanext_cli.runs.results.output_run import output_run
from salsanext_cli.runs.results.paths import DISAGREEMENT, FUSED, ScanFile, drive_order
from salsanext_cli.runs.results.query import ResultQuery
from salsanext_cli.runs.results.selection import scans_of
from salsanext_cli.runs.summary.recorded_summary import recorded_summary
from salsanext_cli.runs.summary.scan_summary import RunSummary

FOLDERS_OF_VOTES = (DISAGREEMENT, "views")

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
    target = target or out / FUSED
    if target.resolve() == out.resolve():
        raise UsageError("TARGET", f"{target} has the labels of single scans", "another folder")
    fusible = fusible_results(out, query)
    warn_without_movable_classes(fusible.space)  # Here, not in each worker
    stop = options.on_error == "stop"
    # Other shards compute the drives of their sequences.
    sequences = sequences_of(options.shard.select(fusible.scans))
    drives_by_poses = fusible.drives_by_poses(sequences, poses, stop=stop)
    summary = RunSummary(sensor=fusible.sensor, space=fusible.space, scans=fusible.scans)
    votes = output_run(
        out,
        "fuse",
        fusible.settings_of_votes(reach),
        FOLDERS_OF_VOTES,
        fusible.scans,
        overwrite=options.overwrite,
    )
    labels = output_run(
        target,
        "fuse",
        fusible.settings_of_labels(reach, target),
        (*FOLDERS_OF_VOTES, "predictions"),
        fusible.scans,
        overwrite=options.overwrite,
    )
    with (
        votes as single_run,
        labels as fused_run,
        recorded_summary(summary, fused_run, fusible.scans),
    ):

        def drive_of(name: str) -> Drive:
            files = fusible.members[name]
            return drive_of_run(files, drives_by_poses[name], single_run, fused_run, fusible.sensor)

        drives = by_sequence(sequences, drive_of, stop=stop)

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
            task, fusible.scans, options, is_done=is_done, summary=summary, writes=[out, target]
        )
    return replace(outcome, missing=fusible.missing)


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
