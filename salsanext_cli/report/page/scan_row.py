# SPDX-License-Identifier: MIT
"""One scan of a run in numbers: its points, classes, uncertainty, rejected and wrong points."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np

from salsanext_cli.core.measures.counts import ScanCounts
from salsanext_cli.core.measures.decision import DOUBTFUL
from salsanext_cli.core.measures.scores import Counts, accepted, scored_rows
from salsanext_cli.core.records import Float
from salsanext_cli.core.uncertainty.kinds import UNCERTAINTY
from salsanext_cli.io.files.reading import present
from salsanext_cli.io.formats.kitti_labels import read_labels
from salsanext_cli.runs.results.output_paths import output_path
from salsanext_cli.runs.results.provenance import Provenance
from salsanext_cli.runs.results.scan_results import read_kind
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.summary.comparison import ScanComparison


@dataclass(frozen=True, slots=True, kw_only=True)
class PointErrors:
    """Probability of error over the points with a label, also if it was rejected since."""

    points: int = 0  # Number of points with a label, which have a probability of error
    total: float = 0.0  # Sum of the probabilities
    doubtful: int = 0  # Number of points with a probability above `DOUBTFUL`

    @classmethod
    def from_values(cls, error: Float) -> Self:
        """Count errors (N,), 0…1, NaN where unknown."""
        estimated = error[np.isfinite(error)]
        return cls(
            points=len(estimated),
            total=float(estimated.sum(dtype=np.float64)),
            doubtful=int(np.count_nonzero(estimated > np.float32(DOUBTFUL))),
        )

    def __add__(self, other: PointErrors) -> PointErrors:
        """Return the sums over the points of both."""
        return PointErrors(
            points=self.points + other.points,
            total=self.total + other.total,
            doubtful=self.doubtful + other.doubtful,
        )

    @property
    def mean(self) -> float | None:
        """Mean probability of error, 0…1; None without points."""
        return self.total / self.points if self.points else None

    @property
    def doubtful_share(self) -> float | None:
        """Share of the points above `DOUBTFUL`, 0…1; None without points."""
        return self.doubtful / self.points if self.points else None


@dataclass(frozen=True, slots=True, kw_only=True)
class Rejection:
    """Points whose label was rejected, among those that had one."""

    points: int = 0  # Number of points that had a label
    rejected: int = 0  # Number of these whose label was rejected

    def __add__(self, other: Rejection) -> Rejection:
        """Return the sums over the points of both."""
        return Rejection(points=self.points + other.points, rejected=self.rejected + other.rejected)

    @property
    def share(self) -> float:
        """Share of the points with a label that were rejected, 0…1."""
        return self.rejected / max(self.points, 1)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ScanRow:
    """One scan in numbers."""

    file: ScanFile
    points: int  # Number of points with a label or an uncertainty
    class_points: Counts  # (C,) int64: number of points by predicted train id
    uncertainty: dict[str, float]  # Mean over the points by kind; NaN without any
    # (C, C) as `scored_rows`, of accepted points if the run rejected labels
    confusion: Counts
    errors: PointErrors = PointErrors()
    rejected: Rejection = Rejection()

    @property
    def judged(self) -> int:
        """Number of points in `confusion`."""
        return int(self.confusion.sum())

    @property
    def wrong(self) -> float:
        """Share of wrong points in `confusion`, 0…1; NaN without points."""
        return float(1 - self.confusion.trace() / self.judged) if self.judged else math.nan

    @classmethod
    def read(cls, file: ScanFile, reader: ScanComparison) -> tuple[Self, ScanCounts | None]:
        """Read the results of a scan and, if it has labels, count its points."""
        out = reader.out
        space = reader.space
        points = 0
        class_points = np.zeros(space.class_count, np.int64)
        path = output_path(out, file.sequence, "predictions", file.stem)
        is_labelled = present(path)
        if is_labelled:
            predicted = space.to_train(read_labels(path), strict=False, source=path)
            points = len(predicted)
            class_points = np.bincount(predicted, minlength=space.class_count)
        values = _uncertainty(file, out, points)
        points = points or max(map(len, values.values()), default=0)
        uncertainty = {kind: _mean(point_values) for kind, point_values in values.items()}
        errors = PointErrors.from_values(values["error"]) if "error" in values else PointErrors()
        counts = None
        confusion = np.zeros((space.class_count, space.class_count), np.int64)
        if is_labelled and reader.has_truth(file):
            counts = reader.count(file)
            confusion = scored_rows(counts.confusion, space)
            confusion = accepted(confusion) if reader.rejects else confusion
        rejected = _rejected(out, values)
        row = cls(
            file=file,
            points=points,
            class_points=class_points,
            uncertainty=uncertainty,
            confusion=confusion,
            errors=errors,
            rejected=rejected,
        )
        return row, counts


def _uncertainty(file: ScanFile, out: Path, points: int) -> dict[str, Float]:
    """Read the known kinds of uncertainty of a scan, arrays (N,) float32."""
    values: dict[str, Float] = {}
    for kind in UNCERTAINTY:
        path = output_path(out, file.sequence, f"uncertainty/{kind}", file.stem)
        if present(path):
            values[kind] = read_kind(path, kind, points or None)
            points = len(values[kind])
    return values


def _mean(values: Float) -> float:
    """Return the mean of the finite values; NaN without any."""
    finite = values[np.isfinite(values)]
    return float(finite.mean(dtype=np.float64)) if len(finite) else math.nan


def _rejected(out: Path, values: dict[str, Float]) -> Rejection:
    """Count the points above the threshold of the run; none without a threshold."""
    settings = Provenance(out).prediction()
    if settings is None or settings.reject is None:
        return Rejection()
    uncertainty = values.get(settings.reject_by or "error")
    if uncertainty is None:
        return Rejection()
    points = int(np.count_nonzero(~np.isnan(uncertainty)))
    return Rejection(
        points=points, rejected=int(np.count_nonzero(uncertainty > np.float32(settings.reject)))
    )
