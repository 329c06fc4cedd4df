# SPDX-License-Identifier: MIT
"""Stage `fuse`: labels of the scans of a drive by all scans that see the same places."""

import logging
import os
import shlex
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.errors import (
    NOTICE,
    NoInputError,
    OutputError,
    SalsanextError,
    UsageError,
    counted,
)
from salsanext_cli.files.json_files import encode_json, read_json
from salsanext_cli.files.optional_packages import import_extra
from salsanext_cli.files.reading import present
from salsanext_cli.fitting.scan_checks import Finding
from salsanext_cli.formats import read_scan
from salsanext_cli.formats.kitti import read_labels
from salsanext_cli.fusion.drive import DRIVE, Drive, recorded_drive
from salsanext_cli.fusion.pose_checks import best_reading, require_fitting
from salsanext_cli.fusion.poses import POSES, Poses, encode_poses, pose_readings, read_fused_poses
from salsanext_cli.fusion.registration import register
from salsanext_cli.fusion.top_classes import kept_softmax
from salsanext_cli.fusion.window import (
    FusionWindow,
    disagreement,
    fused_labels,
    movable_classes,
    voting,
)
from salsanext_cli.measures.scan_summary import RunSummary, ScanSummary
from salsanext_cli.option_fields import FusionReach
from salsanext_cli.parallel.run import Outcome, RunOptions, run_over_scans
from salsanext_cli.records import Float
from salsanext_cli.results.output_run import OutputRun, output_run
from salsanext_cli.results.owned_folder import OwnedFolder, foreign_file
from salsanext_cli.results.paths import (
    DISAGREEMENT,
    SCAN_FOLDER,
    SINGLE_SCAN_STAGES,
    ScanFile,
    drive_order,
    find_outputs,
    find_scans,
    output_path,
    with_outputs,
)
from salsanext_cli.results.query import ResultQuery
from salsanext_cli.results.result_folder import ResultFolder
from salsanext_cli.results.selection import MissingResults, choose, scans_of
from salsanext_cli.results.settings import StageSettings
from salsanext_cli.sensors.sensor import Sensor

FUSED = "fused"  # Folder of the fused labels in that of the labels of single scans
SOFTMAX_FOLDERS = ("probabilities", "votes")

Found = TypeVar("Found")

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class FuseTask:
    """Fusion of the scans of drives, one after the other."""

    members: Mapping[str, Sequence[ScanFile]]  # In order, all with a softmax, by sequence
    drives: Mapping[str, Drive | SalsanextError]  # By sequence
    space: LabelSpace
    sensor: Sensor
    reach: FusionReach
    single: OutputRun  # Takes what other views say against the labels of single scans
    fused: OutputRun  # Takes the fused labels
    # Neighbours share what they read, so that a chunk is much longer than the reach
    max_chunk_scans: int = 400

    def open(self) -> Callable[[], Callable[[ScanFile], ScanSummary]]:
        """Return what makes the function of the scans of a chunk."""
        return self._function

    def _function(self) -> Callable[[ScanFile], ScanSummary]:
        """Return the function of a scan; the window moves from one scan to the next."""
        windows: dict[str, FusionWindow] = {}  # Of the sequence that is worked on
        numbers = {f: n for files in self.members.values() for n, f in enumerate(files)}

        def fuse_scan(file: ScanFile) -> ScanSummary:
            drive = self.drives[file.sequence]
            if isinstance(drive, SalsanextError):
                raise drive
            if file.sequence not in windows:
                windows.clear()
                windows[file.sequence] = self._window(self.members[file.sequence], drive)
            return self._fuse(file, numbers[file], windows[file.sequence])

        return fuse_scan

    def _window(self, files: Sequence[ScanFile], drive: Drive) -> FusionWindow:
        def read(index: int) -> tuple[Float, Float, Any]:
            file = files[index]
            points = read_scan(file.path, self.sensor).points
            softmax = kept_softmax(self.single.root, file, len(points), self.space)
            return points, softmax, voting(softmax)

        return FusionWindow(drive, read, self.reach, self.space.movable)

    def _fuse(self, file: ScanFile, number: int, window: FusionWindow) -> ScanSummary:
        self.single.require_replaceable(file)
        self.fused.require_replaceable(file)
        tally = window.tally(number)
        path = output_path(self.single.root, file.sequence, "predictions", file.stem)
        labels = self.space.to_train(read_labels(path, len(tally.views)), source=path)
        fused = fused_labels(tally, labels)
        for run, of_run in ((self.single, labels), (self.fused, fused)):
            run.write_array(file, DISAGREEMENT, disagreement(tally, of_run))
            run.write_array(file, "views", tally.views)
        self.fused.write_labels(file, self.space.to_raw(fused))
        return ScanSummary.of_labels(file, fused, self.space)


@dataclass(frozen=True, slots=True)
class FusibleResults:
    """Labels and softmax of single scans that can be fused."""

    results: ResultFolder
    scans: Sequence[ScanFile]  # Scans that are wanted, with labels and softmax
    members: Mapping[str, Sequence[ScanFile]]  # All scans with both in the order of the drive
    space: LabelSpace
    sensor: Sensor
    missing: MissingResults  # Wanted scans without labels or softmax

    @property
    def sequences(self) -> list[str]:
        """Names of the sequences of the wanted scans."""
        return list(dict.fromkeys(file.sequence for file in self.scans))

    def given_drives(
        self, poses: Path | None, options: RunOptions
    ) -> dict[str, Drive | SalsanextError | None]:
        """Read the poses of each sequence, by default those in its folder; None without any."""
        if poses is not None and len(self.sequences) > 1:
            found = f"one file for {counted(len(self.sequences), 'sequence')}"
            raise UsageError("--poses", found, hint="choose one of them with --sequences")

        def given_of(name: str) -> Drive | None:
            files = self.members[name]
            path = poses or _beside(files)
            return _checked(path, _read_given(path, files), files, self.sensor) if path else None

        return _of_each(self.sequences, given_of, options)

    def settings(self, reach: FusionReach, target: Path) -> tuple[StageSettings, StageSettings]:
        """Return the settings to record beside the labels of single scans, and the fused ones."""
        origins = self.results.origins(SINGLE_SCAN_STAGES)
        of_single = StageSettings(reach=reach, origins=origins)
        network = self.results.settings("predict") or StageSettings()
        return of_single, replace(
            of_single,
            weights=network.weights,
            weights_version=network.weights_version,
            inherited=network.inherited,
            trained_on=network.trained_on,
            temperature=network.temperature,
            label_space=self.space,
            sensor=self.sensor,
            fused_of=os.path.relpath(self.results.root, target),
        )


def fusible_results(out: Path, query: ResultQuery) -> FusibleResults:
    """Find what `predict` left in a folder to be fused; refuse labels that cannot be."""
    if (predicted := OwnedFolder(out, "predict")).is_shared():
        raise predicted.busy()
    results = ResultFolder(out, query.dataset)
    if results.rejection():
        found, hint = "labels of which some were rejected", "predict without --reject"
        raise OutputError(out, found, "all labels: others vote for what was rejected", hint)
    present_scans = results.scans()
    known = with_outputs(present_scans, out, *SOFTMAX_FOLDERS)
    known = with_outputs(known, out, "predictions")
    space, of_softmax = results.label_space(), results.label_space(*SOFTMAX_FOLDERS)
    if not known or space is None or of_softmax is None:
        words = "--fuse --overwrite" if results.record("fuse") else "--fuse"
        hint = f"run `salsanext predict SCANS {out} {words}`, or with --probabilities"
        raise NoInputError(out, "no softmax of any scan", "votes or probabilities", hint)
    if not space.fits(of_softmax):
        found = f"labels in the classes of {space.name}, softmax in those of {of_softmax.name}"
        raise OutputError(out, found, "the same for both", "predict both again")
    compared = results.compared_space(known, other_ids=True)
    wanted, has_softmax = choose(present_scans, query.selection, compared, out), {*known}
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
    """Fuse what `predict` said of the scans of drives into `TARGET/sequences/<seq>/predictions`.

    What other views say against the labels goes to `uncertainty/disagreement` of both folders.
    `poses`: of the one sequence; by default those in its folder, else they are computed.
    """
    target = target or out / FUSED
    if target.resolve() == out.resolve():
        raise UsageError("TARGET", f"{target}, the folder of the single labels", "another folder")
    found = fusible_results(out, query)
    movable_classes(found.space)  # Warns here, not in each worker.
    given, sensor, scans = found.given_drives(poses, options), found.sensor, found.scans
    summary = RunSummary.of_scans(scans, sensor, found.space)
    kinds, overwrite = (DISAGREEMENT, "views"), options.overwrite
    of_single, of_fused = found.settings(reach, target)
    with (
        output_run(out, "fuse", of_single, kinds, scans, overwrite=overwrite) as single,
        output_run(
            target, "fuse", of_fused, (*kinds, "predictions"), scans, overwrite=overwrite
        ) as fused,
        summary.recorded_in(fused, scans),
    ):

        def drive_of(name: str) -> Drive:
            return _drive_of(found.members[name], given[name], single, fused, sensor)

        def is_done(file: ScanFile) -> bool:
            is_known = isinstance(drives[file.sequence], Drive)
            return is_known and single.is_done(file) and fused.is_done(file)

        drives = _of_each(found.sequences, drive_of, options)
        for name, of_drive in drives.items():
            if isinstance(of_drive, Drive):
                summary.add_sequence(name, _findings(found.members[name], of_drive))
        task = FuseTask(found.members, drives, found.space, sensor, reach, single, fused)
        outcome = run_over_scans(task, scans, options, is_done=is_done, summary=summary)
    return replace(outcome, missing=found.missing)


def _of_each(
    sequences: Iterable[str], function: Callable[[str], Found], options: RunOptions
) -> dict[str, Found | SalsanextError]:
    """Return what a function finds of each sequence, or why it fails; raise if all of them do."""
    found: dict[str, Found | SalsanextError] = {}
    for name in sequences:
        try:
            found[name] = function(name)
        except SalsanextError as error:
            if options.on_error == "stop":
                raise
            found[name] = error
    errors = [each for each in found.values() if isinstance(each, SalsanextError)]
    if errors and len(errors) == len(found):
        raise errors[0]
    return found


def require_fusable(source: Path | Sequence[Path], out: Path, options: RunOptions) -> None:
    """Refuse to predict and fuse a share, or without the package for poses that scans lack."""
    if options.shard.count > 1:
        hint = f"run `salsanext fuse {out}` when all shares are predicted"
        raise UsageError("--fuse", "only a share of the scans", "all of them", hint)
    sequences = {
        name: sorted(group, key=drive_order)
        for name, group in groupby(scans_of(source), lambda file: file.sequence)
    }

    def require(name: str) -> None:
        if (poses := _beside(sequences[name])) is None:
            import_extra("small_gicp", "fuse")
        else:
            _read_given(poses, sequences[name])

    # What is no pose is said before an hour of prediction.
    for error in _of_each(sequences, require, options).values():
        if error is not None:
            log.error("%s", error)


def _beside(files: Sequence[ScanFile]) -> Path | None:
    """Return the poses in the folder of a sequence, None without any."""
    folder = files[0].path.parent
    path = (folder.parent if folder.name == SCAN_FOLDER else folder) / POSES
    return path if present(path) else None


def _read_given(path: Path, files: Sequence[ScanFile]) -> list[Poses]:
    beside = sorted(find_scans(files[0].path.parent, unique=False), key=drive_order)
    stems, wanted = ([*dict.fromkeys(file.stem for file in each)] for each in (beside, files))
    return pose_readings(path, stems, wanted)


def _checked(
    path: Path, readings: Sequence[Poses], files: Sequence[ScanFile], sensor: Sensor
) -> Drive:
    def read(index: int) -> Float:
        return _points(files[index], sensor)

    counted_from = best_reading(readings, read)
    if counted_from == 1:
        log.log(NOTICE, "%s: scan names are line numbers counted from 1: the scans fit best", path)
    poses = readings[counted_from]
    return Drive(poses, require_fitting(path, poses, read))


def _points(file: ScanFile, sensor: Sensor) -> Float:
    """Read the measured points (N, 3) of a scan; none of one that cannot be read."""
    try:
        points = read_scan(file.path, sensor).points
    except SalsanextError:
        return np.zeros((0, 3), np.float32)  # Its own turn says why.
    return points[np.isfinite(points).all(axis=1)]


def _drive_of(
    files: Sequence[ScanFile],
    given: Drive | SalsanextError | None,
    single: OutputRun,
    fused: OutputRun,
    sensor: Sensor,
) -> Drive:
    """Return the poses of a sequence, computed if not given; record them and its scans."""
    if isinstance(given, SalsanextError):
        raise given
    name, stems = files[0].sequence, [file.stem for file in files]
    folder = fused.root / "sequences" / name
    used, record = folder / POSES, folder / DRIVE
    before, edited = read_json(record), bool(fused.foreign_files([used]))
    known = before is not None and before.get("scans") == stems
    if before is not None and not known and not fused.overwrite:
        raise _other_drive(record, single)
    if given is not None:
        drive = given
    elif edited:
        drive = _checked(used, [read_fused_poses(used, stems, stems)], files, sensor)
    elif known and not fused.overwrite and (earlier := recorded_drive(folder)) is not None:
        drive = earlier
    else:
        log.log(NOTICE, "sequence %s: no %s, computing poses of its scans", name, POSES)
        drive = register(_points(file, sensor) for file in files)
    if edited and not np.array_equal(read_fused_poses(used, stems, stems), drive.poses):
        raise foreign_file(used)
    recorded = drive.record(stems)
    with fused.locked_records():
        if read_json(record) != recorded:
            results = [(run, _results_of(run, name)) for run in (single, fused)]
            if any(paths for _, paths in results) and not fused.overwrite:
                raise _other_drive(record, single)
            for run, paths in results:
                run.remove_written(paths)
            if not edited:
                fused.write(used, encode_poses(drive.poses))
            # It comes last: without it, a run that was killed before begins anew.
            fused.write(record, encode_json(recorded))
    return drive


def _results_of(run: OutputRun, sequence: str) -> list[Path]:
    results = (find_outputs(run.root, folder) for folder in run.folders)
    return [path for found in results for (of, _), path in found.items() if of == sequence]


def _other_drive(record: Path, single: OutputRun) -> OutputError:
    """Return the error of results that have votes of other scans, or by other poses."""
    target, sequence = record.parents[2], record.parent.name
    found = f"does not have the scans and poses that `fuse` found now for {single.root}"
    words = ["fuse", str(single.root), str(target), "--sequences", sequence, "--overwrite"]
    hint = f"run `salsanext {shlex.join(words)}`, with --poses if you gave it"
    return OutputError(record, found, "the same scans and poses for all of it", hint)


def _findings(files: Sequence[ScanFile], drive: Drive) -> list[Finding]:
    """Return what is doubtful about a drive that is cut into parts."""
    parts = np.bincount(drive.parts)
    if (parts == 1).all():
        return [Finding("apart", "no two of its scans see common places", "labels stay")]
    if len(parts) == 1:
        return []
    second = files[int(np.argmax(drive.parts == 1))].stem
    found = f"poses fit in {len(parts)} parts only, the second from {second} on"
    return [Finding("apart", found, "parts have no votes for each other; look at its poses")]
