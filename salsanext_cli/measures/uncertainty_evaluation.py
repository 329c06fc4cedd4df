# SPDX-License-Identifier: MIT
"""Evaluation of probabilities and uncertainties: of all points, by class and by distance."""

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Generic, TypeVar

import numpy as np

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.files.json_files import plain
from salsanext_cli.measures.calibration import (
    CalibrationScores,
    Reliability,
    calibration_scores,
    reliability,
)
from salsanext_cli.measures.histograms import Histogram
from salsanext_cli.measures.risk_coverage import (
    AcceptedPoints,
    RankingScores,
    accepted_points,
    ranking_scores,
    risk_coverage,
    spearman,
)
from salsanext_cli.measures.scan_counts import (
    BAND_NAMES,
    CLASS,
    DISTANCE,
    EVALUATED_KINDS,
    OF_ERROR,
    SOFTMAX,
    ScanCounts,
)
from salsanext_cli.measures.scores import Ratios
from salsanext_cli.results.uncertainty_kinds import UNCERTAINTY

log = logging.getLogger(__name__)

KINDS_OF_THRESHOLD = ("error", "entropy")  # A threshold is suggested for the first available

Scores = TypeVar("Scores", CalibrationScores, RankingScores)


@dataclass(frozen=True, slots=True, kw_only=True)
class GroupedScores(Generic[Scores]):
    """Scores of all points, by class and by distance."""

    scores: Scores  # Over all points
    scans: int  # Number of scans with points
    without_value: int  # Number of points
    classes: dict[int, Scores]  # Scores by train id
    by_distance: dict[str, Scores]  # Scores by name of the distance band; empty if not requested

    def to_json(self, space: LabelSpace) -> dict[str, object]:
        """Return plain data for JSON, the scores first; null stands for NaN."""
        data = {f.name: v for f in fields(self) if (v := getattr(self, f.name)) is not None}
        scores, classes, bands = (plain(data.pop(k)) for k in ("scores", "classes", "by_distance"))
        counts = {"scans": data.pop("scans"), "left_out": data.pop("without_value")}
        named = [{"name": space.names[i], "train_id": i, **v} for i, v in classes.items()]
        return {**counts, **scores, **plain(data), "classes": named, "by_distance": bands}


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationResult(GroupedScores[CalibrationScores]):
    """Calibration of probabilities, by most probable class.

    Among the points of a predicted class, a calibrated network is right as often as its confidence;
    among the points of a true class it need not be.
    """

    ece_per_scan: float  # Expected calibration error of a scan over 10 bins, mean over the scans
    reliability: Reliability  # The diagram over 15 bins


@dataclass(frozen=True, slots=True, kw_only=True)
class RankingResult(GroupedScores[RankingScores]):
    """Scores of one kind of uncertainty as a detector of wrong points, by true class."""

    # Rank correlation, over the classes present, of mean uncertainty and number of points, -1…1
    class_size_correlation: float
    risk_coverage: Ratios  # (100,): share of wrong points among the least uncertain 1 %, … 100 %
    thresholds: Ratios  # (100,) float64: largest uncertainty of these points, at most 1 % too large
    # Only for the error, which is a probability: expected calibration error, 0…1, its diagram, and
    # (S, 2) mean error and share of wrong points of each scan
    ece: float | None = None
    reliability: Reliability | None = None
    by_scan: Ratios | None = None


@dataclass(frozen=True, slots=True)
class UncertaintyEvaluation:
    """Evaluation of the probabilities and uncertainties of predictions."""

    calibration: CalibrationResult | None  # Result for the probabilities; None without any
    kinds: dict[str, RankingResult]  # Results by kind of uncertainty
    accepted: AcceptedPoints | None = None  # Suggested threshold, if all scans have a kind

    def to_json(self, space: LabelSpace) -> dict[str, object]:
        """Return plain data for JSON, without absent parts; null stands for NaN."""
        parts = {
            "calibration": self.calibration and self.calibration.to_json(space),
            "uncertainty": {kind: result.to_json(space) for kind, result in self.kinds.items()},
            "kept": self.accepted and plain(self.accepted) | {"sentence": self.accepted.sentence},
        }
        return {name: part for name, part in parts.items() if part}


def evaluate_uncertainty(counts: ScanCounts, space: LabelSpace) -> UncertaintyEvaluation:
    """Divide the counts of all scans; warn of files that only some of the scans have."""
    for folder in (SOFTMAX, *(f"uncertainty/{kind}" for kind in UNCERTAINTY)):
        if 0 < counts.files[folder] < counts.scans:
            log.warning("only %d of %d scans have %s", counts.files[folder], counts.scans, folder)
    known = (kind for kind in EVALUATED_KINDS if (kind, CLASS) in counts.histograms)
    kinds = {kind: _ranking_result(counts, kind, space) for kind in known}
    has_softmax = (SOFTMAX, CLASS) in counts.histograms
    softmax = _calibration_result(counts, space) if has_softmax else None
    error, confidence = kinds.get("error"), kinds.get("least_confidence")
    if counts.accepted:
        error = None  # Only accepted points have it, all points have the softmax.
    if error and confidence and error.scores.aurc > confidence.scores.aurc:
        log.warning("the error ranks labels worse than the confidence: use --reject with care")
    if error and error.ece and softmax and error.ece > softmax.scores.ece:
        log.warning("the error is calibrated worse than the softmax: do not read it as a share")
    accepted = next(
        (
            accepted_points(kind, histogram)
            for kind in KINDS_OF_THRESHOLD
            if counts.files[f"uncertainty/{kind}"] == counts.scans
            and (histogram := counts.histograms.get((kind, CLASS)))
            and histogram.points.any()
        ),
        None,
    )
    return UncertaintyEvaluation(softmax, kinds, accepted)


def _calibration_result(counts: ScanCounts, space: LabelSpace) -> CalibrationResult:
    errors, by_class = counts.calibration_errors, counts.histograms[SOFTMAX, CLASS]
    return CalibrationResult(
        scores=calibration_scores(by_class),
        scans=by_class.scans,
        without_value=by_class.without_value,
        classes=_of_classes(calibration_scores, by_class, space),
        by_distance=_of_bands(calibration_scores, counts, SOFTMAX),
        ece_per_scan=math.fsum(errors) / len(errors) if errors else math.nan,
        reliability=reliability(by_class.total().counts[:, 0]),
    )


def _ranking_result(counts: ScanCounts, kind: str, space: LabelSpace) -> RankingResult:
    by_class = counts.histograms[kind, CLASS]
    present, means = by_class.points > 0, by_class.means("uncertainty")
    risk, thresholds = risk_coverage(*by_class.total().counts[:, 0])
    of_error = counts.histograms[OF_ERROR].counts[:, 0] if kind == "error" else None
    diagram = None if of_error is None else reliability(of_error)
    return RankingResult(
        scores=ranking_scores(by_class),
        scans=by_class.scans,
        without_value=by_class.without_value,
        classes=_of_classes(ranking_scores, by_class, space),
        by_distance=_of_bands(ranking_scores, counts, kind),
        class_size_correlation=spearman(means[present], by_class.points[present]),
        risk_coverage=risk,
        thresholds=thresholds,
        ece=diagram.error if diagram else None,
        reliability=diagram,
        by_scan=np.array(sorted(counts.errors)).reshape(-1, 2) if diagram else None,
    )


def _of_classes(
    divide: Callable[[Histogram], Scores], by_class: Histogram, space: LabelSpace
) -> dict[int, Scores]:
    return {i: divide(by_class.group(i)) for i in np.flatnonzero(space.scored).tolist()}


def _of_bands(
    divide: Callable[[Histogram], Scores], counts: ScanCounts, key: str
) -> dict[str, Scores]:
    by_band = counts.histograms.get((key, DISTANCE))
    return {name: divide(by_band.group(i)) for i, name in enumerate(BAND_NAMES) if by_band}
