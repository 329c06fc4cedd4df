# SPDX-License-Identifier: MIT
"""Stage `filter`: scans in their format, without the points of some classes."""

import logging
from collections.abc import Collection, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from salsanext_cli.core.classes.label_space import LabelSpace, TrainIds
from salsanext_cli.core.classes.merging import MOVABLE, named_classes
from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.geometry.projection import measured_ranges, without_ego
from salsanext_cli.core.measures.filtered_points import FilteredPoints
from salsanext_cli.core.records import Mask, Scan
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.texts import counted, first_few, with_hint
from salsanext_cli.core.wording import argument, command, setting
from salsanext_cli.io.files.reading import filled, present
from salsanext_cli.io.formats import read_scan
from salsanext_cli.io.formats.kitti_labels import read_labels
from salsanext_cli.io.formats.recordings import recording_of
from salsanext_cli.io.formats.subsets import subsets_of
from salsanext_cli.runs.loop.run import Outcome, RunOptions, run_over_scans
from salsanext_cli.runs.results.layouts import SCAN_FOLDER
from salsanext_cli.runs.results.manifest import StageRecord, require_same_settings, settings_json
from salsanext_cli.runs.results.owned_folder import OwnedFolder, foreign_file
from salsanext_cli.runs.results.paths import (
    ERROR,
    PREDICTION_STAGES,
    ScanFile,
    output_path,
    with_outputs,
)
from salsanext_cli.runs.results.query import ResultQuery
from salsanext_cli.runs.results.recorded_origins import sensor_of_result
from salsanext_cli.runs.results.result_folder import ChosenResults, ResultFolder, read_kind

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class FilterSettings:
    """Settings that select the remaining points of scans; None are not recorded."""

    label_space: LabelSpace
    max_error: float | None  # Largest probability of error of the remaining points
    origins: Mapping[str, str]  # Digests of the settings of earlier stages, by name
    results: str  # Absolute path of the folder of the labels
    classes: tuple[str, ...]  # Classes whose points remain
    # Whether your own vehicle and points without a measurement go too
    measured_only: bool | None = None
    # Whether points without a probability of error go too, which remained in earlier versions
    with_error_only: bool | None = None


@dataclass(frozen=True, slots=True)
class FilteredScan:
    """Mask (N,) of the remaining points of a scan, and their number."""

    remains: Mask
    counts: FilteredPoints


@dataclass(frozen=True, slots=True)
class WrittenScan:
    """Name of a filtered scan, and the number of its points."""

    name: str
    counts: FilteredPoints


@dataclass(frozen=True, slots=True)
class PointFilter:
    """Filter of the points of scans by their results."""

    results: ResultFolder
    owned: OwnedFolder
    settings: FilterSettings
    space: LabelSpace
    selected: Mask  # (C,) train ids of the remaining classes
    sensor: Sensor  # Sensor with the columns of files that do not name theirs
    foreign: frozenset[Path] = frozenset()  # Files that are not as salsanext wrote them

    def path(self, file: ScanFile) -> Path:
        """Return the path of the remaining points of a scan."""
        return self.owned.root / "sequences" / file.sequence / SCAN_FOLDER / file.path.name

    def filtered(self, file: ScanFile) -> FilteredScan:
        """Choose the remaining points of a scan."""
        path = output_path(self.results.root, file.sequence, "predictions", file.stem)
        if not present(path):
            raise self.results.missing_column("label", file)
        settings = self.settings
        scan = read_scan(file.path, self.sensor) if settings.measured_only else None
        labels = read_labels(path, None if scan is None else len(scan))
        train = self.space.to_train(labels, source=path)
        remains = self.selected[train]
        if scan is not None:
            remains &= self._measured(file, scan)
        without_error = 0
        if settings.max_error is not None:
            errors = output_path(self.results.root, file.sequence, ERROR, file.stem)
            if not present(errors):
                raise self.results.missing_column("error", file)
            error = read_kind(errors, "error", len(train))
            without_error = int(np.count_nonzero(remains & np.isnan(error)))
            remains &= error <= settings.max_error
        rejected = int(np.count_nonzero(remains & self._rejected(file, train)))
        remaining = int(np.count_nonzero(remains))
        counts = FilteredPoints(len(train), remaining, rejected, without_error)
        return FilteredScan(remains, counts)

    def _measured(self, file: ScanFile, scan: Scan) -> Mask:
        """Return the mask (N,) of the points with a measurement outside the vehicle."""
        sensor = sensor_of_result(self.results.root, file, scan, self.sensor)
        return measured_ranges(without_ego(scan, sensor).points)[1]

    def _rejected(self, file: ScanFile, labels: TrainIds) -> Mask:
        """Return the mask (N,) of the points whose label `predict --reject` rejected."""
        settings = self.results.prediction()
        none = np.zeros(len(labels), bool)
        if settings is None or settings.reject is None:
            return none
        kind = settings.reject_by or "error"
        path = output_path(self.results.root, file.sequence, f"uncertainty/{kind}", file.stem)
        if not present(path):
            return none
        uncertainty = read_kind(path, kind, len(labels))
        return (labels == 0) & (uncertainty > np.float32(settings.reject))

    def is_done(self, file: ScanFile) -> bool:
        """Return whether the remaining points of a scan are written."""
        path = self.path(file)
        return filled(path) and path not in self.foreign

    def write(self, file: ScanFile) -> WrittenScan:
        """Write the remaining points of a scan, if there are any."""
        filtered = self.filtered(file)
        path = self.path(file)
        content = subsets_of(file.path, self.sensor.columns)(filtered.remains)
        if filtered.counts.remaining:
            if path in self.foreign:
                raise foreign_file(path)
            self.owned.write(path, content)
        elif present(path):
            self.owned.remove_written([path])
        return WrittenScan(file.name, filtered.counts)


def filter_scans(
    out: Path,
    folder: Path,
    *,
    drop: Collection[str] = (),
    keep: Collection[str] = (),
    max_error: float | None = None,
    query: ResultQuery = ResultQuery(),
    options: RunOptions = RunOptions(),
) -> Outcome:
    """Write scans in their format, without some of their points, to `FOLDER/sequences/<seq>/`.

    Parameters
    ----------
    out : Path
        Folder with the labels.
    folder : Path
        Folder for the scans.
    drop, keep : collection of str
        Classes as of `named_classes` that are removed, or that alone remain.
    max_error : float, optional
        Largest probability of error of the remaining points; points without one are dropped.
    query, options
        Choice of scans, data set and classes; workers, and what to do with existing results.

    Returns
    -------
    Outcome
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
    if empty := sorted(scan.name for scan in written if not scan.counts.remaining):
        log.warning("no point remains of %s: %s", counted(len(empty), "scan"), first_few(empty))
    if drop and total.rejected:
        log.warning("%s", _words_of_rejected(total.rejected, drop, task.space))
    return replace(outcome, missing=chosen.missing, filtered_points=total)


def _words_of_rejected(count: int, drop: Collection[str], space: LabelSpace) -> str:
    """Return the warning about remaining points whose label was rejected."""
    points = (
        "1 point remains although its" if count == 1 else f"{count:,} points remain although their"
    )
    rejecting = command("predict", argument("reject"))
    problem = f"{points} class is unknown: `{rejecting}` rejected the label"
    names = tuple(dict.fromkeys([*drop, space.names[0]]))
    settings = (setting("drop", names), setting("overwrite", True))
    too = command("to drop them too:", *settings)
    without = f"filter results of `predict` without {argument('reject')}"
    return with_hint(problem, f"{too}; to drop them by their class, {without}")


def _point_filter(
    out: Path,
    folder: Path,
    drop: Collection[str],
    keep: Collection[str],
    max_error: float | None,
    query: ResultQuery,
) -> tuple[PointFilter, ChosenResults]:
    """Return the filter of the options of `filter_scans`, and the chosen scans; refuse others."""
    if not (drop or keep or max_error is not None):
        expected = f"{argument('drop')}, {argument('keep')} or {argument('max_error')}"
        raise UsageError("filter", "no points to drop", expected)
    if max_error is not None and not 0 <= max_error <= 1:
        raise UsageError(argument("max_error"), f"{max_error:g}", "a probability from 0 to 1")
    results = ResultFolder(out, query.dataset)
    chosen = results.chosen(query)
    scans, space = chosen.scans, chosen.space
    selected = named_classes(keep or space.names, space) & ~named_classes(drop, space)
    if max_error is not None and not with_outputs(scans, out, ERROR):
        raise results.missing_column("error", scans[0])
    if recording := recording_of(scans[0].path):
        hint = f"run `salsanext convert {recording} DATA`, then predict and filter DATA"
        problem = "is a recording, which `filter` cannot write"
        raise UsageError(recording, problem, "files of scans", hint)
    settings = FilterSettings(
        results=str(out.absolute()),
        classes=tuple(np.array(space.names)[selected].tolist()),
        measured_only=MOVABLE in drop or None,
        max_error=max_error,
        with_error_only=True if max_error is not None else None,
        label_space=space,
        origins=results.origins(PREDICTION_STAGES),
    )
    owned, sensor = OwnedFolder(folder, "filter"), results.sensor()
    return PointFilter(results, owned, settings, space, selected, sensor), chosen


def _begin(owned: OwnedFolder, settings: FilterSettings, overwrite: bool) -> None:
    """Record the settings in a new folder, or one with the same settings unless overwriting."""
    wanted = StageRecord(stage=owned.stage, settings=settings_json(settings))
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
