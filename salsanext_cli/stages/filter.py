# SPDX-License-Identifier: MIT
"""Stage `filter`: scans in their own format, without the points of some classes."""

import logging
from collections.abc import Callable, Collection
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from salsanext_cli.classes.label_space import LabelSpace, label_space
from salsanext_cli.classes.merging import ClassMerging, contradiction
from salsanext_cli.errors import UsageError, counted, first_few
from salsanext_cli.files.reading import filled, present
from salsanext_cli.formats import read_scan
from salsanext_cli.formats.kitti import read_labels
from salsanext_cli.formats.recordings import recording_of
from salsanext_cli.formats.subsets import subsets_of
from salsanext_cli.geometry.projection import measured_ranges, without_ego
from salsanext_cli.geometry.scan_traits import sensor_of
from salsanext_cli.parallel.run import Outcome, RunOptions, run_over_scans
from salsanext_cli.records import Mask
from salsanext_cli.results.manifest import StageRecord, require_same_settings, settings_json
from salsanext_cli.results.output_run import encode_array
from salsanext_cli.results.owned_folder import OwnedFolder, foreign_file
from salsanext_cli.results.paths import (
    ERROR,
    PREDICTION_STAGES,
    SCAN_FOLDER,
    ScanFile,
    output_path,
    with_outputs,
)
from salsanext_cli.results.query import ResultQuery
from salsanext_cli.results.result_folder import ResultFolder, read_kind
from salsanext_cli.results.settings import StageSettings
from salsanext_cli.sensors.sensor import Sensor

MASKS = "masks"  # Folder of a sequence with masks of its scans' points
MOVING = "moving"
"""Name of all movable classes, and where they are dropped, of all that is not the scene."""
REMEDY = "`salsanext convert {} DATA`, then predict and filter DATA; or masks, with --indices"
Count = tuple[str, int, int]  # Name of a scan, number of its points, and of those that stay

log = logging.getLogger(__name__)


def named_classes(names: Collection[str], space: LabelSpace) -> Mask:
    """Return the train ids (C,) that names mean: classes, coarse ones, or `MOVING` for a group."""
    known: dict[str, Mask] = {MOVING: space.movable}
    if MOVING in names:
        space.require_movable(f"class {MOVING}")
    coarse = label_space("coarse")
    if not contradiction(space, coarse):
        groups = zip(coarse.names, ClassMerging.between(space, coarse).groups, strict=True)
        known |= {name: np.isin(np.arange(space.class_count), ids) for name, ids in groups}
    known |= dict(zip(space.names, np.eye(space.class_count, dtype=bool), strict=True))
    if unknown := [name for name in names if name not in known]:
        raise UsageError(f"class {unknown[0]}", "no such class", f"one of {', '.join(known)}")
    meant = np.zeros(space.class_count, bool)
    for name in names:
        meant |= known[name]
    return meant


@dataclass(frozen=True, slots=True, kw_only=True)
class FilterSettings(StageSettings):
    """Settings that decide which points of scans stay."""

    results: str  # Folder of the labels, absolute
    classes: tuple[str, ...]  # Classes whose points stay
    split: bool
    indices: bool
    measured_only: bool | None = None


@dataclass(frozen=True, slots=True)
class PointFilter:
    """Filter of the points of scans by their results."""

    results: ResultFolder
    owned: OwnedFolder
    space: LabelSpace
    stays: Mask  # (C,) train ids
    measured_only: bool  # Whether housing, vehicle and points without a measurement go
    max_error: float | None
    split: bool
    indices: bool
    sensor: Sensor  # With the columns of files that do not name theirs
    kept: frozenset[Path] = frozenset()  # Files that are there and not as they were written

    @property
    def folders(self) -> tuple[str, ...]:
        """Folders of a sequence that parts of scans go to."""
        if self.split:
            return self.space.names
        return (MASKS,) if self.indices else (SCAN_FOLDER,)

    def path(self, file: ScanFile, part: str) -> Path:
        """Return where a part of a scan goes."""
        name = f"{file.stem}.npy" if self.indices else file.path.name
        return self.owned.root / "sequences" / file.sequence / part / name

    def parts(self, file: ScanFile) -> tuple[dict[str, Mask], int]:
        """Return which points (N,) stay, by the folder that they go to, if any do; and N."""
        path = output_path(self.results.root, file.sequence, "predictions", file.stem)
        if not present(path):
            raise self.results.missing_column("label", file)
        # Where the scan is not written, nothing else compares the number of its points.
        is_read = self.indices or self.measured_only
        scan = read_scan(file.path, self.sensor) if is_read else None
        labels = read_labels(path, None if scan is None else len(scan))
        train = self.space.to_train(labels, source=path)
        stay = self.stays[train]
        if scan is not None and self.measured_only:
            stay &= measured_ranges(without_ego(scan, sensor_of(scan, self.sensor)).points)[1]
        if self.max_error is not None:
            errors = output_path(self.results.root, file.sequence, ERROR, file.stem)
            if not present(errors):
                raise self.results.missing_column("error", file)
            stay &= ~(read_kind(errors, "error", len(train)) > self.max_error)
        if self.split:
            occurring = np.unique(train[stay]).tolist()
            return {self.space.names[i]: stay & (train == i) for i in occurring}, len(train)
        return ({self.folders[0]: stay} if self.indices or stay.any() else {}), len(train)

    def is_done(self, file: ScanFile) -> bool:
        """Say whether all parts of a scan are there."""
        paths = {part: self.path(file, part) for part in self.folders}
        there = {part for part, path in paths.items() if filled(path) and path not in self.kept}
        return bool(there) and (not self.split or there >= self.parts(file)[0].keys())

    def write(self, file: ScanFile) -> Count:
        """Write the parts of a scan; return its name, and how many points it has and keeps."""
        parts, count = self.parts(file)
        absent = (self.path(file, part) for part in self.folders if part not in parts)
        if stale := [path for path in absent if present(path)]:
            self.owned.remove_written(stale)
        encode: Callable[[Mask], bytes] = encode_array
        if not self.indices:
            encode = subsets_of(file.path, self.sensor.columns)
        if not parts:
            encode(np.zeros(count, bool))
        for part, mask in parts.items():
            if (path := self.path(file, part)) in self.kept:
                raise foreign_file(path)
            self.owned.write(path, encode(mask))
        return file.name, count, sum(int(mask.sum()) for mask in parts.values())


def filter_scans(
    out: Path,
    folder: Path,
    *,
    drop: Collection[str] = (),
    keep: Collection[str] = (),
    max_error: float | None = None,
    split: bool = False,
    indices: bool = False,
    query: ResultQuery = ResultQuery(),
    options: RunOptions = RunOptions(),
) -> Outcome:
    """Write `FOLDER/sequences/<seq>/velodyne/`: the scans as they are, without some points.

    `drop`, `keep`: as of `named_classes`; `indices`: masks (N,) bool of them in the place of scans.
    """
    if not (drop or keep or split or max_error is not None):
        raise UsageError("--drop, --keep, --max-error, --split", "none given", "one of them")
    if max_error is not None and not 0 <= max_error <= 1:
        raise UsageError("--max-error", f"{max_error:g}", "a probability from 0 to 1")
    results, owned = ResultFolder(out, query.dataset), OwnedFolder(folder, "filter")
    chosen = results.chosen(query)
    scans, space = chosen.scans, chosen.space
    stays = named_classes(keep or space.names, space) & ~named_classes(drop, space)
    measured_only = MOVING in drop
    if max_error is not None and not with_outputs(scans, out, ERROR):
        raise results.missing_column("error", scans[0])
    if recording := None if indices else recording_of(scans[0].path):
        found, expected = "a recording, which `filter` does not write", "files of scans"
        raise UsageError(recording, found, expected, REMEDY.format(recording))
    if odd := [name for name in space.names if split and Path(name).name != name]:
        raise UsageError("--split", f"class {odd[0]}", "names that folders can have")
    settings = FilterSettings(
        results=str(out.absolute()),
        classes=tuple(np.array(space.names)[stays].tolist()),
        split=split,
        indices=indices,
        measured_only=measured_only or None,
        max_error=max_error,
        label_space=space,
        origins=results.origins(PREDICTION_STAGES),
    )
    sensor = results.sensor()
    task = PointFilter(
        results, owned, space, stays, measured_only, max_error, split, indices, sensor
    )
    counts = list[Count]()
    with ExitStack() as stack:
        with owned.locked_records():
            _begin(owned, settings, options.overwrite)
            stack.enter_context(owned.open(shared=True))
        parts = [task.path(file, part) for file in scans for part in task.folders]
        task = replace(task, kept=frozenset(owned.foreign_files(parts)))
        outcome = run_over_scans(
            task.write, scans, options, is_done=task.is_done, on_result=counts.append
        )
    total = sum(count for _, count, _ in counts), sum(kept for *_, kept in counts)
    if empty := sorted(name for name, _, kept in counts if not kept):
        log.warning("no point stays of %s: %s", counted(len(empty), "scan"), first_few(empty))
    return replace(outcome, missing=chosen.missing, kept_points=total)


def _begin(owned: OwnedFolder, settings: FilterSettings, overwrite: bool) -> None:
    """Record the settings in a new folder or one with the same; overwriting replaces others."""
    wanted = StageRecord(owned.stage, settings_json(settings))
    recorded = owned.manifest.record(owned.stage)
    if recorded is None:
        owned.require_new()
    elif not recorded.has_settings(wanted.settings):
        replaced = [path for path in owned.written() if path != owned.record_path]
        if replaced and not overwrite:
            require_same_settings(owned.record_path, recorded.settings, wanted.settings)
        if owned.is_shared():
            raise owned.busy()
        owned.remove_written(replaced)
    owned.manifest.write(wanted)
