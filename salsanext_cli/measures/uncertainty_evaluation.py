# SPDX-License-Identifier: MIT
"""Evaluation of probabilities and uncertainties: of all points, by class and by distance."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Generic, TypeVar

import numpy as np

from salsanext_cli.classes import LabelSpace
from salsanext_cli.measures.calibration import CalibrationScores, calibration_scores
from salsanext_cli.measures.confusion import Ratios
from salsanext_cli.measures.correlation import spearman
from salsanext_cli.measures.distance import RING_NAMES
from salsanext_cli.measures.grouped_histogram import GroupedHistogram
from salsanext_cli.measures.reliability import Reliability, reliability
from salsanext_cli.measures.risk_coverage import (
    RankingScores,
    ranking_scores,
    risk_at,
    threshold_at,
)
from salsanext_cli.measures.scan_counts import CLASS, FOLDERS, KINDS, RING, ScanCounts
from salsanext_cli.measures.scores import plain

COVERAGE = np.arange(1, 101) / 100
"""Shares of the points, the least uncertain ones first, at which the risk is given."""

log = logging.getLogger(__name__)

Histogram = TypeVar("Histogram", bound=GroupedHistogram)
Scores = TypeVar("Scores", CalibrationScores, RankingScores)


@dataclass(frozen=True, slots=True, kw_only=True)
class GroupedScores(Generic[Scores]):
    """Scores of all points, by class and by distance.

    Attributes
    ----------
    scores : CalibrationScores or RankingScores
        Over all points.
    scans, left_out : int
        Number of scans with points, and of points without a value.
    classes : dict of int to scores
        Scores by train id.
    rings : dict of str to scores
        Scores by name of the ring of distance; empty if not requested.
    """

    scores: Scores
    scans: int
    left_out: int
    classes: dict[int, Scores]
    rings: dict[str, Scores]

    def plain(self, space: LabelSpace, more: Mapping[str, Any]) -> dict[str, Any]:
        """Return plain data for JSON, with more in the middle; null stands for NaN."""
        data: dict[str, Any] = plain(
            {"scans": self.scans, "left_out": self.left_out, **asdict(self.scores), **more}
            | {
                "classes": [
                    {"name": space.names[i], "train_id": i, **asdict(of_class)}
                    for i, of_class in self.classes.items()
                ],
                "by_distance": {name: asdict(ring) for name, ring in self.rings.items()},
            }
        )
        return data


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationResult(GroupedScores[CalibrationScores]):
    """Calibration of probabilities.

    Classes are the most probable ones: among the points of such a class, a calibrated network is
    right as often as its confidence says; among the points of a true class it need not be.

    Attributes
    ----------
    scan_error : float
        Expected calibration error of a scan over 10 bins, mean over the scans, 0…1.
    reliability : Reliability
        The diagram over 15 bins.
    """

    scan_error: float
    reliability: Reliability

    def to_dict(self, space: LabelSpace) -> dict[str, Any]:
        """Return plain data for JSON; null stands for NaN."""
        diagram = asdict(self.reliability)
        return self.plain(space, {"ece_per_scan": self.scan_error, "reliability": diagram})


@dataclass(frozen=True, slots=True, kw_only=True)
class RankingResult(GroupedScores[RankingScores]):
    """Scores of one kind of uncertainty as a detector of wrong points; classes are the true ones.

    Attributes
    ----------
    risk : (100,) float64
        Share of wrong points among the least uncertain 1 %, 2 %, … 100 %.
    thresholds : (100,) float64
        Largest uncertainty of these points, at most 1 % too large.
    correlation : float
        Spearman's rank correlation, over the classes present, of the mean uncertainty of a class
        and its number of points, -1…1.
    """

    risk: Ratios
    thresholds: Ratios
    correlation: float

    def to_dict(self, space: LabelSpace) -> dict[str, Any]:
        """Return plain data for JSON; null stands for NaN."""
        curves = {"risk_coverage": self.risk, "thresholds": self.thresholds}
        return self.plain(space, {"class_size_correlation": self.correlation} | curves)


@dataclass(frozen=True, slots=True)
class UncertaintyEvaluation:
    """Evaluation of the probabilities and uncertainties that lie beside predictions.

    Attributes
    ----------
    calibration : CalibrationResult or None
        Result for the probabilities; None without any.
    kinds : dict of str to RankingResult
        Results by kind of uncertainty; empty without any.
    """

    calibration: CalibrationResult | None
    kinds: dict[str, RankingResult]

    def to_dict(self, space: LabelSpace) -> dict[str, Any]:
        """Return plain data for JSON, without absent parts; null stands for NaN."""
        data: dict[str, Any] = {}
        if self.calibration:
            data["calibration"] = self.calibration.to_dict(space)
        if self.kinds:
            data["uncertainty"] = {k: found.to_dict(space) for k, found in self.kinds.items()}
        return data


def evaluate_uncertainty(counts: ScanCounts, space: LabelSpace) -> UncertaintyEvaluation:
    """Divide the counts of all scans; warn of files that only some of the scans have."""
    for folder in FOLDERS:
        if 0 < counts.files[folder] < counts.scans:
            log.warning("%s of %d of %d scans only", folder, counts.files[folder], counts.scans)
    kinds = [kind for kind in KINDS if (kind, CLASS) in counts.uncertainty]
    return UncertaintyEvaluation(
        calibration=_calibration_result(counts, space) if counts.confidence else None,
        kinds={kind: _ranking_result(counts, kind, space) for kind in kinds},
    )


def _calibration_result(counts: ScanCounts, space: LabelSpace) -> CalibrationResult:
    by_class, errors = counts.confidence[CLASS], counts.calibration_errors
    return CalibrationResult(
        **_grouped(calibration_scores, by_class, counts.confidence.get(RING), space),
        scan_error=math.fsum(errors) / len(errors) if errors else math.nan,
        reliability=reliability(by_class.total().counts[:, 0]),
    )


def _ranking_result(counts: ScanCounts, kind: str, space: LabelSpace) -> RankingResult:
    by_class = counts.uncertainty[kind, CLASS]
    present = by_class.points > 0
    right, wrong = by_class.total().counts[:, 0]
    return RankingResult(
        **_grouped(ranking_scores, by_class, counts.uncertainty.get((kind, RING)), space),
        risk=risk_at(right, wrong, COVERAGE),
        thresholds=threshold_at(right, wrong, COVERAGE),
        correlation=spearman(by_class.means("uncertainty")[present], by_class.points[present]),
    )


def _grouped(
    divide: Callable[[Histogram], Scores],
    by_class: Histogram,
    by_ring: Histogram | None,
    space: LabelSpace,
) -> dict[str, Any]:
    """Return the fields of `GroupedScores`."""
    return {
        "scores": divide(by_class),
        "scans": by_class.scans,
        "left_out": by_class.left_out,
        "classes": {i: divide(by_class.group(i)) for i in np.flatnonzero(space.scored).tolist()},
        "rings": {name: divide(by_ring.group(i)) for i, name in enumerate(RING_NAMES)}
        if by_ring
        else {},
    }
