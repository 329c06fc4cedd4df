# SPDX-License-Identifier: MIT
"""Stage `filter`: scans in their format, without the points of some classes."""

import logging
from collections.abc import Collection
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.classes.merging import MOVABLE, named_classes
from salsanext_cli.errors import UsageError, counted, first_few
from salsanext_cli.files.reading import filled, present
from salsanext_cli.formats import read_scan
from salsanext_cli.formats.kitti import read_labels
from salsanext_cli.formats.recordings import recording_of
from salsanext_cli.formats.subsets import subsets_of
from salsanext_cli.geometry.projection import measured_ranges, without_ego
from salsanext_cli.parallel.run import Outcome, RunOptions, run_over_scans
from salsanext_cli.records import Mask
from salsanext_cli.results.layouts import SCAN_FOLDER
from salsanext_cli.results.manifest import (
    StageRecord,
    StageSettings,
    require_same_settings,
    settings_json,
)
from salsanext_cli.results.owned_folder import OwnedFolder, foreign_file
from salsanext_cli.results.paths import (
    ERROR,
    PREDICTION_STAGES,
    ScanFile,
    output_path,
    with_outputs,
)
from salsanext_cli.results.query import ResultQuery
from salsanext_cli.results.recorded_origins import sensor_of_result
from salsanext_cli.results.result_folder import ChosenResults, ResultFolder, read_kind
from salsanext_cli.sensors.sensor import Sensor

Count = tuple[str, int, int]  # Name of a scan, number of its points, and of the remaining ones

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class FilterSettings(StageSettings):
    """Settings that select the remaining points of scans."""

    results: str  # Absolute path of the folder of the labels
    classes: tuple[str, ...]  # Classes whose points remain
    # Whether your own vehicle and points without a measurement go too
    measured_only: bool | None = None


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

    def mask(self, file: ScanFile) -> Mask:
        """Return the mask (N,) of the remaining points of a scan."""
        path = output_path(self.results.root, file.sequence, "predictions", file.stem)
        if not present(path):
            raise self.results.missing_column("label", file)
        settings = self.settings
        scan = read_scan(file.path, self.sensor) if settings.measured_only else None
        labels = read_labels(path, None if scan is None else len(scan))
        train = self.space.to_train(labels, source=path)
        remains = self.selected[train]
        if scan is not None:
            sensor = sensor_of_result(self.results.root, file, scan, self.sensor)
            remains &= measured_ranges(without_ego(scan, sensor).points)[1]
        if settings.max_error is not None:
            errors = output_path(self.results.root, file.sequence, ERROR, file.stem)
            if not present(errors):
                raise self.results.missing_column("error", file)
            remains &= ~(read_kind(errors, "error", len(train)) > settings.max_error)
        return remains

    def is_done(self, file: ScanFile) -> bool:
        """Return whether the remaining points of a scan are written."""
        path = self.path(file)
        return filled(path) and path not in self.foreign

    def write(self, file: ScanFile) -> Count:
        """Write the points; return the name of the scan and its points before and after."""
        mask, path = self.mask(file), self.path(file)
        content = subsets_of(file.path, self.sensor.columns)(mask)
        if mask.any():
            if path in self.foreign:
                raise foreign_file(path)
            self.owned.write(path, content)
        elif present(path):
            self.owned.remove_written([path])
        return file.name, len(mask), int(mask.sum())


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
        Largest probability of error of the remaining points.
    query, options
        Choice of scans, data set and classes; workers, and what to do with existing results.

    Returns
    -------
    Outcome
    """
    task, chosen = _point_filter(out, folder, drop, keep, max_error, query)
    counts = list[Count]()
    with ExitStack() as stack:
        with task.owned.locked_records():
            _begin(task.owned, task.settings, options.overwrite)
            stack.enter_context(task.owned.open(shared=True))
        paths = map(task.path, chosen.scans)
        task = replace(task, foreign=frozenset(task.owned.foreign_files(paths)))
        outcome = run_over_scans(
            task.write, chosen.scans, options, is_done=task.is_done, on_result=counts.append
        )
    total = sum(count for _, count, _ in counts), sum(left for *_, left in counts)
    if empty := sorted(name for name, _, left in counts if not left):
        log.warning("no point remains of %s: %s", counted(len(empty), "scan"), first_few(empty))
    return replace(outcome, missing=chosen.missing, accepted_points=total)


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
        raise UsageError("filter", "no points to drop", "--drop, --keep or --max-error")
    if max_error is not None and not 0 <= max_error <= 1:
        raise UsageError("--max-error", f"{max_error:g}", "a probability from 0 to 1")
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
        label_space=space,
        origins=results.origins(PREDICTION_STAGES),
    )
    owned, sensor = OwnedFolder(folder, "filter"), results.sensor()
    return PointFilter(results, owned, settings, space, selected, sensor), chosen


def _begin(owned: OwnedFolder, settings: FilterSettings, overwrite: bool) -> None:
    """Record the settings in a new folder, or one with the same settings unless overwriting."""
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
