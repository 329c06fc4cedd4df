# SPDX-License-Identifier: MIT
"""Evaluation of probabilities and uncertainties."""

import logging
import math
from dataclasses import dataclass, fields

from salsanext_cli.files.json_files import plain
from salsanext_cli.measures.calibration import (
    CalibrationScores,
    Reliability,
    calibration_scores,
    reliability,
)
from salsanext_cli.measures.risk_coverage import (
    AcceptedPoints,
    RankingScores,
    accepted_points,
    ranking_scores,
    risk_coverage,
)
from salsanext_cli.measures.scan_counts import EVALUATED_KINDS, OF_ERROR, SOFTMAX, ScanCounts
from salsanext_cli.measures.scores import Ratios
from salsanext_cli.results.uncertainty_kinds import UNCERTAINTY

log = logging.getLogger(__name__)

KINDS_OF_THRESHOLD = ("error", "entropy")  # A threshold is suggested for the first available


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationResult:
    """Calibration of probabilities."""

    scans: int  # Number of scans with points
    without_value: int  # Number of points
    scores: CalibrationScores
    ece_per_scan: float  # Expected calibration error of a scan over 10 bins, mean over the scans
    reliability: Reliability  # The diagram over 15 bins


@dataclass(frozen=True, slots=True, kw_only=True)
class RankingResult:
    """Scores of one kind of uncertainty as a detector of wrong points."""

    scans: int  # Number of scans with points
    without_value: int  # Number of points
    scores: RankingScores
    risk_coverage: Ratios  # (100,): share of wrong points among the least uncertain 1 %, … 100 %
    thresholds: Ratios  # (100,) float64: largest uncertainty of these points, at most 1 % too large
    # Only for the error, which is a probability: expected calibration error, 0…1, and its diagram
    ece: float | None = None
    reliability: Reliability | None = None


@dataclass(frozen=True, slots=True)
class UncertaintyEvaluation:
    """Evaluation of the probabilities and uncertainties of predictions."""

    calibration: CalibrationResult | None  # Result for the probabilities; None without any
    kinds: dict[str, RankingResult]  # Results by kind of uncertainty
    accepted: AcceptedPoints | None = None  # Suggested threshold, if all scans have a kind

    def to_json(self) -> dict[str, object]:
        """Return plain data for JSON, without absent parts; null stands for NaN."""
        accepted = self.accepted
        parts = {
            "calibration": self.calibration and _flat(self.calibration),
            "uncertainty": {kind: _flat(result) for kind, result in self.kinds.items()},
            "accepted": accepted and plain(accepted) | {"sentence": accepted.sentence},
        }
        return {name: part for name, part in parts.items() if part}


def _flat(result: CalibrationResult | RankingResult) -> dict[str, object]:
    """Return the fields of a result that it has, those of its scores among them."""
    known = {f.name: v for f in fields(result) if (v := getattr(result, f.name)) is not None}
    scores = known.pop("scores")
    return {**plain(scores), **plain(known)}


def evaluate_uncertainty(counts: ScanCounts) -> UncertaintyEvaluation:
    """Divide the counts of all scans; warn of files that only some of the scans have."""
    for folder in (SOFTMAX, *(f"uncertainty/{kind}" for kind in UNCERTAINTY)):
        if 0 < counts.files[folder] < counts.scans:
            log.warning("only %d of %d scans have %s", counts.files[folder], counts.scans, folder)
    known = (kind for kind in EVALUATED_KINDS if kind in counts.histograms)
    kinds = {kind: _ranking_result(counts, kind) for kind in known}
    softmax = _calibration_result(counts) if SOFTMAX in counts.histograms else None
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
            and (histogram := counts.histograms.get(kind))
            and histogram.scans
        ),
        None,
    )
    return UncertaintyEvaluation(softmax, kinds, accepted)


def _calibration_result(counts: ScanCounts) -> CalibrationResult:
    errors, histogram = counts.calibration_errors, counts.histograms[SOFTMAX]
    return CalibrationResult(
        scans=histogram.scans,
        without_value=histogram.without_value,
        scores=calibration_scores(histogram),
        ece_per_scan=math.fsum(errors) / len(errors) if errors else math.nan,
        reliability=reliability(histogram.counts),
    )


def _ranking_result(counts: ScanCounts, kind: str) -> RankingResult:
    histogram = counts.histograms[kind]
    risk, thresholds = risk_coverage(*histogram.counts)
    diagram = reliability(counts.histograms[OF_ERROR].counts) if kind == "error" else None
    return RankingResult(
        scans=histogram.scans,
        without_value=histogram.without_value,
        scores=ranking_scores(histogram),
        risk_coverage=risk,
        thresholds=thresholds,
        ece=diagram.error if diagram else None,
        reliability=diagram,
    )
