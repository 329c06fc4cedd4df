# SPDX-License-Identifier: MIT
"""Everything known about the points of a scan: its own values, labels, truth, uncertainty."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes.label_space import LabelSpace, RawIds
from salsanext_cli.errors import NoInputError
from salsanext_cli.files.reading import present
from salsanext_cli.formats import read_scan
from salsanext_cli.formats.labels import read_labels
from salsanext_cli.formats.npy import read_uncertainty
from salsanext_cli.geometry.points import in_sensor_frame, measured_ranges
from salsanext_cli.records import Float, Scan
from salsanext_cli.results.layout import UNCERTAINTY, ScanFile, output_path, with_outputs
from salsanext_cli.results.predictions import rejected_points
from salsanext_cli.sensors.sensor import Sensor

FOLDERS = ("predictions", *(f"uncertainty/{kind}" for kind in UNCERTAINTY))


@dataclass(frozen=True, slots=True)
class ScanResults:
    """A scan and what is known about it."""

    scan: Scan  # N points
    # (N,) uint32 or None: raw ids, predicted and given, without instances
    label: RawIds | None = None
    truth: RawIds | None = None
    # By kind; only kinds that were computed
    uncertainty: dict[str, Float] = field(default_factory=dict)
    # That the distances are measured from; otherwise it is the origin of the points
    sensor: Sensor | None = None
    # (N,) bool or None: points whose label was taken away by `rejecting`
    rejected: npt.NDArray[np.bool_] | None = None

    @property
    def range(self) -> Float:
        """Distance of every point from the sensor, (N,) float32, metres."""
        with np.errstate(over="ignore"):  # Those too far for float32 become infinite.
            scan = in_sensor_frame(self.scan, self.sensor) if self.sensor else self.scan
            return measured_ranges(scan.points)[0].astype(np.float32)

    def wrong(self, space: LabelSpace) -> Float:
        """Return 1 where the label is wrong, 0 where right, NaN where truth does not count.

        It is NaN too where the label was rejected.
        """
        if self.label is None or self.truth is None:
            raise ValueError("a wrong label needs a label and a truth")
        truth = space.to_train(self.truth, strict=False)
        wrong = (truth != space.to_train(self.label, strict=False)).astype(np.float32)
        counts = space.scored[truth]
        if self.rejected is not None:
            counts = counts & ~self.rejected
        return np.where(counts, wrong, np.float32(np.nan))

    @property
    def rejected_points(self) -> int:
        """Number of points whose label was taken away."""
        return 0 if self.rejected is None else int(self.rejected.sum())

    def rejecting(self, max_error: float, space: LabelSpace) -> ScanResults:
        """Return the same with the points unlabelled whose error is above a threshold.

        A point without an error keeps its label; `predict` has left it unlabelled.
        """
        if self.label is None:
            return self
        above = self.uncertainty["error"] > max_error
        unlabelled = space.to_raw(np.zeros(1, np.uint8)).astype(self.label.dtype)
        return replace(self, label=np.where(above, unlabelled, self.label), rejected=above)


def read_results(
    file: ScanFile,
    out: Path,
    sensor: Sensor | None = None,
    classes: LabelSpace | None = None,
    truth_in: tuple[LabelSpace, LabelSpace] | None = None,
) -> ScanResults:
    """Read a scan and all that `out` and its data set hold about it.

    Predicted classes that are merged into `classes` get their raw ids. The truth is read if
    `truth_in` has the label space of its ids and that to show it in, whose raw ids it gets.
    """
    scan = read_scan(file.path, sensor)
    count = len(scan)
    path, *kinds = (output_path(out, file.sequence, folder, file.stem) for folder in FOLDERS)
    label = _labels(path, count)
    if label is not None and classes is not None:
        label = classes.to_raw(classes.to_train(label, strict=False))
    truth = _labels(file.label_path, count) if truth_in else None
    if truth is not None and truth_in:
        own, space = truth_in
        train = own.to_train(truth, strict=False, source=file.label_path)
        truth = truth if own.learning_map == space.learning_map else space.to_raw(train)
    uncertainty = {
        kind: read_kind(path, kind, count)
        for kind, path in zip(UNCERTAINTY, kinds, strict=True)
        if present(path)
    }
    rejected = rejected_points(out, uncertainty["error"]) if "error" in uncertainty else None
    return ScanResults(scan, label, truth, uncertainty, sensor, rejected)


def read_kind(path: Path, kind: str, count: int | None) -> Float:
    """Read one kind of uncertainty of a scan's points, as `read_uncertainty` does.

    "error" is a probability.
    """
    return read_uncertainty(path, count, 1.0 if kind == "error" else math.inf)


def scalar_columns(cloud: ScanResults, space: LabelSpace) -> dict[str, npt.NDArray[Any]]:
    """Return every scalar known about the points, by the name that its property gets."""
    columns: dict[str, npt.NDArray[Any]] = {
        "intensity": cloud.scan.intensity,
        "range": cloud.range,
    }
    if cloud.label is not None:
        columns["label"] = cloud.label.astype(np.uint16)
    if cloud.truth is not None:
        columns["truth"] = cloud.truth.astype(np.uint16)
        if cloud.label is not None:
            columns["wrong"] = cloud.wrong(space)
    return columns | cloud.uncertainty


def missing_column(column: str, file: ScanFile, out: Path) -> NoInputError:
    """Return the error that says what is missing for a column, and where it would be."""
    if column in ("truth", "wrong") and not present(file.label_path):
        return NoInputError(file.path, "has no labels", str(file.label_path))
    folder = f"uncertainty/{column}" if column in UNCERTAINTY else "predictions"
    stage = "uncertainty" if column in UNCERTAINTY else "predict"
    path = output_path(out, file.sequence, folder, file.stem)
    remedy = f"run `salsanext {stage} SCANS {out}` first"
    if column == "error":
        remedy = (
            f"run `salsanext predict SCANS {out} --error`, with weights that know it: the default "
            "ones, or what `salsanext tune error` writes"
        )
    return NoInputError(file.path, f"no {column} known", str(path), remedy)


def require_column(column: str, scans: Sequence[ScanFile], out: Path) -> None:
    """Refuse a column that is known of none of the scans, with `missing_column`."""
    if column not in ("intensity", "range") and not with_column(column, scans, out):
        raise missing_column(column, scans[0], out)


def with_column(column: str, scans: Sequence[ScanFile], out: Path) -> list[ScanFile]:
    """Return those scans of which there is what a column, one of `COLOURINGS`, is made of."""
    found = list(scans)
    if column in ("truth", "wrong"):
        found = [scan for scan in found if present(scan.label_path)]
    if column in ("label", "wrong"):
        found = with_outputs(found, out, "predictions")
    if column in UNCERTAINTY:
        found = with_outputs(found, out, f"uncertainty/{column}")
    return found


def uncertainty_meant(scans: Sequence[ScanFile], out: Path) -> str:
    """Return the kind that "uncertainty" means: the error where all scans have it, else entropy."""
    return "error" if len(with_column("error", scans, out)) == len(scans) else "entropy"


def with_results(out: Path, scans: list[ScanFile]) -> list[ScanFile]:
    """Leave out the scans for which no stage has left a result."""
    chosen = with_outputs(scans, out, *FOLDERS)
    if not chosen:
        remedy = f"run `salsanext predict SCANS {out}` first"
        raise NoInputError(out, "no results of these scans", remedy=remedy)
    return chosen


def _labels(path: Path, count: int) -> RawIds | None:
    return read_labels(path, count) & np.uint32(0xFFFF) if present(path) else None
