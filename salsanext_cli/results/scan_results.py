# SPDX-License-Identifier: MIT
"""Everything known about the points of a scan: its own values, labels, truth, uncertainty."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes.label_space import LabelSpace, RawIds
from salsanext_cli.formats.npy import read_uncertainty
from salsanext_cli.geometry.projection import in_sensor_frame, measured_ranges
from salsanext_cli.records import Float, Scan
from salsanext_cli.sensors.sensor import Sensor


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
