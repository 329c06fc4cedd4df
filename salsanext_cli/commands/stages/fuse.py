# SPDX-License-Identifier: MIT
"""Stage `fuse`: labels of the scans of a drive by all scans that see the same locations."""

import logging
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import groupby
from pathlib import Path
from typing import TypeVar

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.errors import NoInputError, OutputError, SalsanextError, UsageError
from salsanext_cli.core.fusion.drive import Drive
from salsanext_cli.core.fusion.poses import POSES
from salsanext_cli.core.fusion.reach import FusionReach
from salsanext_cli.core.fusion.window import FusionWindow, warn_without_movable_classes
from salsanext_cli.core.optional_packages import import_extra
from salsanext_cli.core.records import Float
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.texts import counted
from salsanext_cli.core.wording import argument, command, setting
from salsanext_cli.io.files.json_files import encode_json, read_json
from salsanext_cli.io.formats.kitti_labels import read_labels
from salsanext_cli.io.poses import encode_poses
from salsanext_cli.runs.drives.drive import (
    DRIVE,
    drive_record,
    points_of_drive,
    poses_beside,
    readings_of,
    recorded_drive,
)
from salsanext_cli.runs.drives.earlier_fusion import earlier_fusion, other_drive
from salsanext_cli.runs.drives.scans_of_drive import computed_drive, drive_findings, drive_of_scans
from salsanext_cli.runs.drives.stored_softmax import stored_softmax
from salsanext_cli.runs.loop.run import Outcome, RunOptions, run_over_scans
from salsanext_cli.runs.records.digest_files import recorded_scans
from salsanext_cli.runs.records.stage_settings import FuseSettings, PredictSettings
from salsanext_cli.runs.results.output_run import OutputRun, output_run
from salsanext_cli.runs.results.owned_folder import OwnedFolder, foreign_file
from salsanext_cli.runs.results.paths import (
    DISAGREEMENT,
    SINGLE_SCAN_STAGES,
    ScanFile,
    drive_order,
    find_outputs,
    output_path,
    with_outputs,
)
from salsanext_cli.runs.results.query import ResultQuery
from salsanext_cli.runs.results.recorded_origins import recorded_origins
from salsanext_cli.runs.results.result_folder import ResultFolder
from salsanext_cli.runs.results.selection import MissingResults, choose, scans_of
from salsanext_cli.runs.summary.scan_summary import RunSummary, ScanSummary

FUSED = "fused"  # Folder of the fused labels in the folder of the labels of single scans
SOFTMAX_FOLDERS = ("probabilities", "votes")

Value = TypeVar("Value")

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class FuseTask:
    """Task of `run_over_scans` that fuses the scans of drives, one drive after the other."""

    members: Mapping[str, Sequence[ScanFile]]  # Scans with a softmax in order, by sequence
    drives: Mapping[str, Drive | SalsanextError]  # By sequence
    space: LabelSpace
    sensor: Sensor
    reach: FusionReach
    single: OutputRun  # Receives the votes against the labels of single scans
    fused: OutputRun  # Receives the fused labels
    max_chunk_scans: int = 400  # Neighbours share the contents of files.

    def open(self) -> Callable[[ScanFile], ScanSummary]:
        """Return the function of a scan; its window moves from one scan to the next."""
        window_of = lru_cache(maxsize=1)(self._window)
        numbers = {f: n for files in self.members.values() for n, f in enumerate(files)}
        return lambda file: self._fuse(file, numbers[file], window_of(file.sequence))

    def _window(self, sequence: str) -> FusionWindow:
        files, drive = self.members[sequence], self.drives[sequence]
        if isinstance(drive, SalsanextError):
            raise drive

        def read(index: int) -> tuple[Float, Float]:
            origin_of = recorded_origins(self.single.root, self.sensor)
            points = points_of_drive(files[index], self.sensor, origin_of)
            return points, stored_softmax(self.single.root, files[index], len(points), self.space)

        return FusionWindow(drive, read, self.reach, self.space.movable)

    def _fuse(self, file: ScanFile, number: int, window: FusionWindow) -> ScanSummary:
        self.single.require_replaceable(file)
        self.fused.require_replaceable(file)
        tally = window.tally(number)
        path = output_path(self.single.root, file.sequence, "predictions", file.stem)
        labels = self.space.to_train(read_labels(path, len(tally.views)), source=path)
        fused = tally.fused(labels)
        for run, labels_of_run in ((self.single, labels), (self.fused, fused)):
            run.write_array(file, DISAGREEMENT, tally.disagreement(labels_of_run))
            run.write_array(file, "views", tally.views)
        self.fused.write_labels(file, self.space.to_raw(fused))
        return ScanSummary.of_labels(file, fused, self.space)


@dataclass(frozen=True, slots=True)
class FusibleResults:
    """Labels and softmax of single scans that can be fused."""

    results: ResultFolder
    scans: Sequence[ScanFile]  # Selected scans with labels and softmax
    members: Mapping[str, Sequence[ScanFile]]  # All scans with both in the order of the drive
    space: LabelSpace
    sensor: Sensor
    missing: MissingResults  # Selected scans without labels or softmax

    @property
    def sequences(self) -> list[str]:
        """Names of the sequences of the selected scans."""
        return list(dict.fromkeys(file.sequence for file in self.scans))

    def given_drives(
        self, poses: Path | None, options: RunOptions
    ) -> dict[str, Drive | SalsanextError | None]:
        """Return the drive of each sequence, by default by the poses in its folder.

        None without a file; registered scans need none.
        """
        if poses is not None and len(self.sequences) > 1:
            problem = f"is one file for {counted(len(self.sequences), 'sequence')}"
            hint = f"choose one sequence with {argument('sequences')}"
            raise UsageError(argument("poses"), problem, hint=hint)

        origin_of = recorded_origins(self.results.root, self.sensor)

        def drive_of(name: str) -> Drive | None:
            return drive_of_scans(self.members[name], self.sensor, origin_of, poses)

        return by_sequence(self.sequences, drive_of, options)

    def settings_of_votes(self, reach: FusionReach) -> FuseSettings:
        """Return the settings to record beside the labels of single scans."""
        return FuseSettings(reach=reach, origins=self.results.origins(SINGLE_SCAN_STAGES))

    def settings_of_labels(self, reach: FusionReach, target: Path) -> FuseSettings:
        """Return the settings to record for the fused labels in a folder."""
        prediction = self.results.settings("predict") or PredictSettings()
        # The record of the fused labels has a file of its own.
        trained = recorded_scans(prediction.trained_on or "", self.results.path("predict"))
        return FuseSettings(
            label_space=self.space,
            sensor=self.sensor,
            weights=prediction.weights,
            weights_version=prediction.weights_version,
            inherited=prediction.inherited,
            trained_on="".join(sorted(trained.digests)) or prediction.trained_on,
            temperature=prediction.temperature,
            reach=reach,
            fused_of=os.path.relpath(self.results.root, target),
            origins=self.results.origins(SINGLE_SCAN_STAGES),
        )


def _fusible_results(out: Path, query: ResultQuery) -> FusibleResults:
    """Return the results of `predict` in a folder; refuse those that cannot be fused."""
    if (predicted := OwnedFolder(out, "predict")).is_shared():
        raise predicted.busy()
    results = ResultFolder(out, query.dataset)
    if results.rejected_above() is not None:
        problem = "has labels of which some were rejected"
        hint = f"predict without {argument('reject')}"
        raise OutputError(out, problem, "all labels, since votes replace rejected ones", hint)
    present_scans = results.scans()
    known = with_outputs(present_scans, out, *SOFTMAX_FOLDERS)
    known = with_outputs(known, out, "predictions")
    space = results.label_space()
    of_softmax = results.label_space(*SOFTMAX_FOLDERS)
    if not known or space is None or of_softmax is None:
        settings = [setting("extras", ("votes",))]
        if results.record("fuse"):
            settings.append(setting("overwrite", True))
        predict = command("salsanext predict {scans} {out}", *settings)
        other = setting("extras", ("probabilities",))
        hint = results.command(f"run `{predict}`, or with {other}", *present_scans[:1])
        raise NoInputError(out, "has no softmax of any scan", "votes or probabilities", hint)
    if not space.fits(of_softmax):
        problem = f"has labels of {space.name}, but softmax of {of_softmax.name}"
        raise OutputError(out, problem, "the same label space", "predict both again")
    compared = results.compared_space(known, other_ids=True)
    wanted = choose(present_scans, query.selection, compared, out)
    has_softmax = {*known}
    scans = [file for file in wanted if file in has_softmax]
    missing = results.missing_predictions({*wanted} - {*scans})
    missing.log_error(len(wanted), "softmax and labels")
    members: dict[str, list[ScanFile]] = {}
    for file in sorted(known, key=drive_order):
        members.setdefault(file.sequence, []).append(file)
    return FusibleResults(results, scans, members, space, results.sensor(), missing)


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
    out, target : Path
        Folder with labels and softmax of single scans, and folder for the fused labels, by default
        `OUT/fused`.
    poses : Path, optional
        Poses of the one sequence; by default those in its folder, else they are computed.
    reach : FusionReach
        Scans that vote.
    query, options
        Choice of scans and data set; workers, and what to do with existing results.

    Returns
    -------
    Outcome
    """
    if (target := target or out / FUSED).resolve() == out.resolve():
        raise UsageError("TARGET", f"{target} has the labels of single scans", "another folder")
    fusible = _fusible_results(out, query)
    warn_without_movable_classes(fusible.space)  # Here, not in each worker
    given = fusible.given_drives(poses, options)
    sensor = fusible.sensor
    scans = fusible.scans
    summary = RunSummary(sensor=sensor, space=fusible.space, scans=scans)
    kinds = (DISAGREEMENT, "views")
    folders = (*kinds, "predictions")
    overwrite = options.overwrite
    settings = fusible.settings_of_votes(reach)
    settings_of_labels = fusible.settings_of_labels(reach, target)
    votes = output_run(out, "fuse", settings, kinds, scans, overwrite=overwrite)
    labels = output_run(target, "fuse", settings_of_labels, folders, scans, overwrite=overwrite)
    with votes as single, labels as fused, summary.recorded_in(fused, scans):

        def drive_of(name: str) -> Drive:
            return _recorded_drive(fusible.members[name], given[name], single, fused, sensor)

        def is_done(file: ScanFile) -> bool:
            is_drive = isinstance(drives[file.sequence], Drive)
            return is_drive and single.is_done(file) and fused.is_done(file)

        drives = by_sequence(fusible.sequences, drive_of, options)
        for name, drive in drives.items():
            if isinstance(drive, Drive):
                summary.add_sequence(name, drive_findings(fusible.members[name], drive))
        task = FuseTask(fusible.members, drives, fusible.space, sensor, reach, single, fused)
        outcome = run_over_scans(task, scans, options, is_done=is_done, summary=summary)
    return replace(outcome, missing=fusible.missing)


def by_sequence(
    sequences: Iterable[str], function: Callable[[str], Value], options: RunOptions
) -> dict[str, Value | SalsanextError]:
    """Compute a value for each sequence, and go on after errors.

    Parameters
    ----------
    sequences : iterable of str
        Names of the sequences.
    function : callable
        Computes the value of a sequence from its name.
    options : RunOptions
        Whether the first error stops the run.

    Returns
    -------
    dict
        The value of each sequence, or its error.

    Raises
    ------
    SalsanextError
        If all sequences fail, or the first if an error stops the run.
    """
    values: dict[str, Value | SalsanextError] = {}
    for name in sequences:
        try:
            values[name] = function(name)
        except SalsanextError as error:
            if options.on_error == "stop":
                raise
            values[name] = error
    errors = [value for value in values.values() if isinstance(value, SalsanextError)]
    if errors and len(errors) == len(values):
        raise errors[0]
    return values


def require_fusable(source: Path | Sequence[Path], out: Path, options: RunOptions) -> None:
    """Check before a prediction that its results can be fused.

    Parameters
    ----------
    source, out, options
        Scans to predict, output folder for the hint, and options of the run.

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
        if (poses := poses_beside(sequences[name])) is None:
            import_extra("small_gicp", "fuse")
        else:
            readings_of(poses, sequences[name])

    for error in by_sequence(sequences, require, options).values():
        if error is not None:
            log.error("%s", error)


def _recorded_drive(
    files: Sequence[ScanFile],
    given: Drive | SalsanextError | None,
    single: OutputRun,
    fused: OutputRun,
    sensor: Sensor,
) -> Drive:
    """Return the drive of a sequence, computed unless it is given, and record it."""
    if isinstance(given, SalsanextError):
        raise given
    name = files[0].sequence
    stems = [file.stem for file in files]
    folder = fused.root / "sequences" / name
    path = folder / POSES
    record = folder / DRIVE
    if fused.foreign_files([path]):
        raise foreign_file(path)
    before = read_json(record)
    has_same_scans = before is not None and before.get("scans") == stems
    if before is not None and not has_same_scans and not fused.overwrite:
        raise other_drive(record, single)
    earlier = recorded_drive(folder) if has_same_scans and not fused.overwrite else None
    if (drive := given or earlier) is None:
        drive = computed_drive(files, sensor, recorded_origins(single.root, sensor))
    content = drive_record(drive, stems)
    with fused.locked_records():
        if read_json(record) != content:
            results = [(run, _results_of(run, name)) for run in (single, fused)]
            if any(paths for _, paths in results) and not fused.overwrite:
                if before is None and not _results_of(fused, name):
                    raise earlier_fusion(single, fused.root, name)
                raise other_drive(record, single)
            for run, paths in results:
                run.remove_written(paths)
            fused.write(path, encode_poses(drive.poses))
            # Last: without the record, a run that was killed before begins again.
            fused.write(record, encode_json(content))
    return drive


def _results_of(run: OutputRun, sequence: str) -> list[Path]:
    outputs = (find_outputs(run.root, folder) for folder in run.folders)
    return [path for paths in outputs for (name, _), path in paths.items() if name == sequence]
