# SPDX-License-Identifier: MIT
"""Stage `fuse`: labels of the scans of a drive by all scans that see the same places."""

import logging
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.errors import NOTICE, NoInputError, SalsanextError, UsageError, counted
from salsanext_cli.files.identity import fingerprint
from salsanext_cli.files.reading import present
from salsanext_cli.formats import read_scan
from salsanext_cli.formats.kitti import read_labels
from salsanext_cli.formats.npy import read_array, read_probabilities
from salsanext_cli.fusion.poses import (
    POSES,
    Poses,
    encode_poses,
    read_fused_poses,
    read_poses,
    require_fitting,
    segments,
)
from salsanext_cli.fusion.registration import register
from salsanext_cli.fusion.top_classes import KEPT, softmax_of
from salsanext_cli.fusion.window import (
    Drive,
    FusionWindow,
    disagreement,
    fused_labels,
    movable_classes,
    voting,
)
from salsanext_cli.measures.scan_summary import RunSummary, ScanSummary
from salsanext_cli.options import FusionReach, ScanSelection
from salsanext_cli.parallel.run import Outcome, RunOptions, run_over_scans
from salsanext_cli.parallel.worker import Attempt, AttemptFunction
from salsanext_cli.records import Float
from salsanext_cli.results.layout import (
    DISAGREEMENT,
    SCAN_FOLDER,
    ScanFile,
    find_scans,
    output_path,
    with_outputs,
)
from salsanext_cli.results.output_run import OutputRun, output_run
from salsanext_cli.results.result_folder import ResultFolder
from salsanext_cli.results.selection import choose
from salsanext_cli.sensors.sensor import Sensor

FUSED = "fused"
"""Folder of the fused labels in that of the labels of single scans."""
SOFTMAX_FOLDERS = ("probabilities", "votes")
ABOUT_THE_NETWORK = ("weights", "adapted", "trained_on", "temperature")
"""Settings of `predict` that the record of fused labels repeats."""

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class DriveScans:
    """Scans of a drive in order, all with a softmax, and their poses."""

    files: tuple[ScanFile, ...]
    poses: Poses


@dataclass(frozen=True, slots=True)
class FuseTask:
    """Fusion of the scans of drives, one after the other."""

    drives: Mapping[str, DriveScans]  # By name of the sequence
    space: LabelSpace
    sensor: Sensor
    reach: FusionReach
    single: OutputRun  # Takes what other views say against the labels of single scans
    fused: OutputRun  # Takes the fused labels

    def open(self) -> AttemptFunction:
        """Return the function that works on scans; the window moves from one to the next."""
        return self._attempts

    def _attempts(self, files: Iterable[ScanFile]) -> Iterator[Attempt]:
        window, sequence = None, None
        for file in files:
            if window is None or file.sequence != sequence:
                window, sequence = self._window(file.sequence), file.sequence
            try:
                yield file, self._fuse(file, window), None
            except SalsanextError as error:
                yield file, None, error

    def _window(self, sequence: str) -> FusionWindow:
        drive = self.drives[sequence]

        def read(index: int) -> tuple[Float, Float, Any]:
            file = drive.files[index]
            points = read_scan(file.path, self.sensor).points
            softmax = read_softmax(self.single.root, file, len(points), self.space)
            return points, softmax, voting(softmax)

        return FusionWindow(Drive(drive.poses, read), self.reach, movable_classes(self.space))

    def _fuse(self, file: ScanFile, window: FusionWindow) -> ScanSummary:
        self.single.require_replaceable(file)
        self.fused.require_replaceable(file)
        tally = window.tally(self.drives[file.sequence].files.index(file))
        path = output_path(self.single.root, file.sequence, "predictions", file.stem)
        labels = self.space.to_train(read_labels(path, len(tally.views)), source=path)
        fused = fused_labels(tally, labels)
        for run, of_run in ((self.single, labels), (self.fused, fused)):
            run.write_array(file, DISAGREEMENT, disagreement(tally, of_run))
            run.write_array(file, "views", tally.views)
        self.fused.write_labels(file, self.space.to_raw(fused))
        return ScanSummary.of_labels(file, fused, self.space)


def read_softmax(out: Path, file: ScanFile, count: int, space: LabelSpace) -> Float:
    """Read the softmax (N, C) float32 that `predict` kept of a scan's points, or its votes."""
    path = output_path(out, file.sequence, "probabilities", file.stem)
    if present(path):
        return read_probabilities(path, count, space.class_count).astype(np.float32)
    votes = output_path(out, file.sequence, "votes", file.stem)
    kept = min(KEPT, space.class_count)
    return softmax_of(read_array(votes, "uint16", (count, kept)), space.class_count)


def fuse_results(
    out: Path,
    target: Path | None = None,
    *,
    poses: Path | None = None,
    reach: FusionReach = FusionReach(),
    dataset: Path | None = None,
    selection: ScanSelection = ScanSelection(),
    options: RunOptions = RunOptions(),
) -> Outcome:
    """Fuse what `predict` said of the scans of drives into `TARGET/sequences/<seq>/predictions`.

    What other views say against the labels of single scans goes to `uncertainty/disagreement` of
    both folders. `target`: by default `OUT/fused`; `poses`: of the one sequence; by default those
    in its folder, else they are computed and written there.
    """
    target = target or out / FUSED
    if target.resolve() == out.resolve():
        raise UsageError("TARGET", f"{target}, the folder of the single labels", "another folder")
    results = ResultFolder(out, dataset)
    known = with_outputs(results.scans(), out, *SOFTMAX_FOLDERS)
    known = with_outputs(known, out, "predictions")
    space = results.label_space()
    if not known or space is None:
        remedy = f"run `salsanext predict SCANS {out} --fuse`, or with --probabilities"
        raise NoInputError(out, "no softmax of any scan", "votes or probabilities", remedy)
    scans = choose(known, selection, results.compared_space(known, own_ids=True), out)
    members: dict[str, list[ScanFile]] = {}
    for file in known:
        members.setdefault(file.sequence, []).append(file)
    chosen = dict.fromkeys(file.sequence for file in scans)
    if poses is not None and len(chosen) > 1:
        found = f"one file for {counted(len(chosen), 'sequence')}"
        raise UsageError("--poses", found, remedy="choose one of them with --sequences")
    paths = {name: poses or _beside(files) for name, files in members.items()}
    sensor = results.sensor()
    given = {name: _given(paths[name], members[name], sensor) for name in chosen}
    made_with = {
        "reach": asdict(reach),
        "poses": {name: path and fingerprint(path) for name, path in paths.items()},
        "origins": results.origins(["predict", "knn-refine", "uncertainty"]),
    }
    network: Mapping[str, Any] = results.settings("predict") or {}
    of_labels = {
        **{key: network[key] for key in ABOUT_THE_NETWORK if key in network},
        "label_space": space.to_dict(),
        "sensor": sensor.to_dict(),
    }
    summary = RunSummary.of_scans(scans, sensor, space)
    kinds, overwrite = (DISAGREEMENT, "views"), options.overwrite
    single = output_run(out, "fuse", made_with, kinds, scans, overwrite=overwrite)
    folders = (*kinds, "predictions")
    fused = output_run(target, "fuse", made_with | of_labels, folders, scans, overwrite=overwrite)
    with single as of_single, fused as of_fused, summary.kept_in(of_fused, scans):
        drives = {
            name: _drive(name, members[name], given[name], of_fused, sensor) for name in chosen
        }
        task = FuseTask(drives, space, sensor, reach, of_single, of_fused)
        outcome = run_over_scans(
            task,
            scans,
            options,
            is_done=lambda file: of_single.is_done(file) and of_fused.is_done(file),
            on_result=summary.add,
        )
    return replace(outcome, summary=summary)


def _beside(files: Sequence[ScanFile]) -> Path | None:
    """Return the poses in the folder of a sequence, None without any."""
    folder = files[0].path.parent
    path = (folder.parent if folder.name == SCAN_FOLDER else folder) / POSES
    return path if present(path) else None


def _given(path: Path | None, files: Sequence[ScanFile], sensor: Sensor) -> Poses | None:
    """Read the poses of scans, if there are any, and look whether they fit the scans."""
    if path is None:
        return None
    beside = [file.stem for file in find_scans(files[0].path.parent)]
    poses = read_poses(path, beside, [file.stem for file in files])
    require_fitting(
        path, poses, segments(poses), lambda index: read_scan(files[index].path, sensor).points
    )
    return poses


def _drive(
    name: str, files: Sequence[ScanFile], poses: Poses | None, output: OutputRun, sensor: Sensor
) -> DriveScans:
    """Return a sequence with poses, computed if not given, and write them; say where it is cut."""
    stems = [file.stem for file in files]
    used = output.root / "sequences" / name / POSES
    if poses is None and present(used) and not (output.overwrite and not output.others([used])):
        poses = read_fused_poses(used, stems, stems)
    elif poses is None:
        log.log(NOTICE, "sequence %s: no %s, computing poses of its scans", name, POSES)
        poses = register(read_scan(file.path, sensor).points for file in files)
        output.write(used, encode_poses(poses))
    else:
        output.require_own([used])
        output.write(used, encode_poses(poses))
    parts = np.bincount(segments(poses))
    if (parts == 1).all() and len(files) > 1:
        log.warning("sequence %s: its scans see no common places; labels stay", name)
    elif len(parts) > 1:
        log.warning("sequence %s: %s that see no common places", name, counted(len(parts), "part"))
    return DriveScans(tuple(files), poses)
