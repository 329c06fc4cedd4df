# SPDX-License-Identifier: MIT
"""Task of `filter`: the points of a scan that remain, by their labels and errors."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from salsanext_cli.core.classes.label_space import LabelSpace, TrainIds
from salsanext_cli.core.geometry.point_sample import measured_ranges
from salsanext_cli.core.geometry.sensor_frame import without_ego
from salsanext_cli.core.measures.filtered_points import FilteredPoints
from salsanext_cli.core.records import Float, Mask, Scan
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.io.files.reading import filled, present
from salsanext_cli.io.formats import read_scan
from salsanext_cli.io.formats.kitti_labels import read_labels
from salsanext_cli.io.formats.subsets import subsets_of
from salsanext_cli.runs.results.folder_names import ERROR
from salsanext_cli.runs.results.output_paths import output_path
from salsanext_cli.runs.results.owned_folder import OwnedFolder, foreign_file
from salsanext_cli.runs.results.recorded_origins import sensor_of_result
from salsanext_cli.runs.results.result_folder import ResultFolder
from salsanext_cli.runs.results.scan_results import read_kind
from salsanext_cli.runs.scans.layouts import SCAN_FOLDER
from salsanext_cli.runs.scans.scan_file import ScanFile


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


@dataclass(frozen=True, slots=True, kw_only=True)
class FilteredScan:
    """Mask (N,) of the remaining points of a scan, and their number."""

    remains: Mask
    counts: FilteredPoints


@dataclass(frozen=True, slots=True, kw_only=True)
class WrittenScan:
    """Filtered scan, and the number of its points."""

    file: ScanFile
    counts: FilteredPoints


@dataclass(frozen=True, slots=True, kw_only=True)
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
        scan = read_scan(file.path, self.sensor) if self.settings.measured_only else None
        labels = self._labels(file, None if scan is None else len(scan))
        remains = self.selected[labels]
        if scan is not None:
            remains &= self._measured(file, scan)
        without_error = 0
        if self.settings.max_error is not None:
            error = self._error(file, len(labels))
            without_error = int(np.count_nonzero(remains & np.isnan(error)))
            remains &= error <= self.settings.max_error
        counts = FilteredPoints(
            points=len(labels),
            remaining=int(np.count_nonzero(remains)),
            rejected=int(np.count_nonzero(remains & self._rejected(file, labels))),
            without_error=without_error,
        )
        return FilteredScan(remains=remains, counts=counts)

    def filtered_cloud(self, file: ScanFile) -> FilteredScan:
        """Choose the remaining points of a cloud of a bag.

        A cloud without labels has no measurements: its points have neither a class nor an error.
        """
        if present(output_path(self.results.root, file.sequence, "predictions", file.stem)):
            return self.filtered(file)
        count = len(read_scan(file.path, self.sensor))
        accepted = bool(self.selected[0]) and not self.settings.measured_only
        has_limit = self.settings.max_error is not None
        remains = accepted and not has_limit
        counts = FilteredPoints(
            points=count,
            remaining=count if remains else 0,
            without_error=count if accepted and has_limit else 0,
        )
        return FilteredScan(remains=np.full(count, remains), counts=counts)

    def _labels(self, file: ScanFile, count: int | None) -> TrainIds:
        """Read the predicted train ids (N,) of a scan; `count`: number of points, if known."""
        path = output_path(self.results.root, file.sequence, "predictions", file.stem)
        if not present(path):
            raise self.results.missing_column("label", file)
        return self.space.to_train(read_labels(path, count), source=path)

    def _error(self, file: ScanFile, count: int) -> Float:
        """Read the probability of error of each point, (count,) float32, NaN without one."""
        path = output_path(self.results.root, file.sequence, ERROR, file.stem)
        if not present(path):
            raise self.results.missing_column("error", file)
        return read_kind(path, "error", count)

    def _measured(self, file: ScanFile, scan: Scan) -> Mask:
        """Return the mask (N,) of the points with a measurement outside the vehicle."""
        sensor = sensor_of_result(self.results.root, file, scan, self.sensor)
        return measured_ranges(without_ego(scan, sensor).points)[1]

    def _rejected(self, file: ScanFile, labels: TrainIds) -> Mask:
        """Return the mask (N,) of the points whose label `predict --reject` rejected."""
        settings = self.results.provenance.prediction()
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
        return WrittenScan(file=file, counts=filtered.counts)
