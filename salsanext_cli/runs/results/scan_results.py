# SPDX-License-Identifier: MIT
"""Results of one scan: its points, their labels and their uncertainties."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.classes.label_space import LabelSpace, RawIds
from salsanext_cli.core.geometry.point_sample import measured_ranges
from salsanext_cli.core.geometry.sensor_frame import in_sensor_frame
from salsanext_cli.core.records import Float, Scan
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.texts import percentage
from salsanext_cli.core.uncertainty.kinds import UNCERTAINTY
from salsanext_cli.io.files.reading import present
from salsanext_cli.io.formats.kitti_labels import read_labels
from salsanext_cli.io.formats.npy import read_uncertainty
from salsanext_cli.runs.results.folder_names import COLOURS
from salsanext_cli.runs.scans.scan_file import ScanFile

HEIGHT = "height"
PICTURE_COLOURS = (*COLOURS, HEIGHT)
"""Values for the colours of pictures; in a point cloud, the height is a coordinate."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanResults:
    """A scan and its results."""

    scan: Scan  # N points
    label: RawIds | None = None  # (N,) uint32: raw ids without instances, predicted
    truth: RawIds | None = None  # (N,) uint32: raw ids without instances, from the data set
    uncertainty: dict[str, Float] = field(default_factory=dict)  # (N,) by kind
    sensor: Sensor | None = None  # Origin of distances; None for the origin of the scan
    rejected: npt.NDArray[np.bool_] | None = None  # (N,): unlabelled in a run that rejects labels
    instance: npt.NDArray[np.uint16] | None = None  # (N,): numbers of objects, 0 for none

    @property
    def range(self) -> Float:
        """Distance of every point from the sensor, (N,) float32, metres."""
        with np.errstate(over="ignore"):  # Distances above the range of float32 become infinite.
            scan = in_sensor_frame(self.scan, self.sensor) if self.sensor else self.scan
            return measured_ranges(scan.points)[0].astype(np.float32)

    @property
    def height(self) -> Float:
        """Height of every point above the sensor, (N,) float32, metres; NaN if not measured."""
        scan = in_sensor_frame(self.scan, self.sensor) if self.sensor else self.scan
        measured = measured_ranges(scan.points)[1]
        return np.where(measured, scan.points[:, 2], np.float32(np.nan))

    def wrong(self, space: LabelSpace) -> Float:
        """Return 1 for wrong labels, 0 for right ones, NaN for points that do not count, (N,)."""
        if self.label is None or self.truth is None:
            raise ValueError("a wrong label needs a label and a truth")
        truth = space.to_train(self.truth, strict=False)
        wrong = (truth != space.to_train(self.label, strict=False)).astype(np.float32)
        counts = space.scored[truth]
        if self.rejected is not None:
            counts = counts & ~self.rejected
        return np.where(counts, wrong, np.float32(np.nan))

    def accepted_text(self, space: LabelSpace) -> str:
        """Return coverage and risk of the accepted labels in words; empty if all are accepted."""
        if self.rejected is None or self.truth is None:
            return ""
        scored = space.scored[space.to_train(self.truth, strict=False)]
        wrong = self.wrong(space)
        judged = wrong[~np.isnan(wrong)]
        coverage = len(judged) / max(scored.sum(), 1)
        risk = judged.sum() / max(len(judged), 1)
        return f"coverage {percentage(coverage)}, risk {percentage(risk)}"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PointLabels:
    """Labels of the points of a scan, as a label file has them."""

    raw: RawIds  # (N,) uint32: raw ids without instances
    objects: npt.NDArray[np.uint16] | None  # (N,): numbers of objects, 0 for none


def read_point_labels(path: Path, count: int) -> PointLabels | None:
    """Read raw ids and numbers of objects; None if there is no such file."""
    if not present(path):
        return None
    labels = read_labels(path, count)
    return PointLabels(raw=labels & np.uint32(0xFFFF), objects=(labels >> 16).astype(np.uint16))


def read_truth(
    file: ScanFile, count: int, space_of_file: LabelSpace, space: LabelSpace
) -> RawIds | None:
    """Read the true raw ids of a scan, converted to a label space.

    Parameters
    ----------
    file : ScanFile
        Scan, beside which its labels lie.
    count : int
        Number N of its points.
    space_of_file : LabelSpace
        Meaning of the ids in the label file.
    space : LabelSpace
        Label space of the returned ids.

    Returns
    -------
    ndarray of uint32 (N,), or None
        None without labels.

    Raises
    ------
    LabelError
        If too many ids are unknown to the label space of the file.
    """
    labels = read_point_labels(file.label_path, count)
    if labels is None:
        return None
    train = space_of_file.to_train(labels.raw, strict=False, source=file.label_path)
    if space_of_file.learning_map == space.learning_map:
        return labels.raw
    return space.to_raw(train)


def read_kind(path: Path, kind: str, count: int | None) -> Float:
    """Read one kind of uncertainty of a scan's points (see `read_uncertainty`)."""
    return read_uncertainty(path, count, UNCERTAINTY[kind].most)


def scalar_columns(cloud: ScanResults, space: LabelSpace) -> dict[str, npt.NDArray[Any]]:
    """Return every scalar of the points, (N,), by the name of its property."""
    columns: dict[str, npt.NDArray[Any]]
    columns = {"intensity": cloud.scan.intensity, "range": cloud.range}
    if cloud.label is not None:
        columns["label"] = cloud.label.astype(np.uint16)
    if cloud.instance is not None:
        columns["instance"] = cloud.instance
    if cloud.truth is not None:
        columns["truth"] = cloud.truth.astype(np.uint16)
        if cloud.label is not None:
            columns["wrong"] = cloud.wrong(space)
    return columns | cloud.uncertainty


def picture_columns(cloud: ScanResults, space: LabelSpace) -> dict[str, npt.NDArray[Any]]:
    """Return every value of the points that pictures can show, (N,), by its colour."""
    return {HEIGHT: cloud.height, **scalar_columns(cloud, space)}
