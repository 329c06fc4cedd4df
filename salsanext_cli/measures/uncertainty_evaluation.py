# SPDX-License-Identifier: MIT
"""Evaluation of probabilities and uncertainties."""

import logging
from dataclasses import asdict, dataclass

from salsanext_cli.files.json_files import plain
from salsanext_cli.measures.histograms import CalibrationScores, calibration_scores, reliability
from salsanext_cli.measures.risk_coverage import (
    AcceptedPoints,
    RankingScores,
    accepted_points,
    ranking_scores,
)
from salsanext_cli.measures.scan_counts import EVALUATED_KINDS, OF_ERROR, SOFTMAX, ScanCounts
from salsanext_cli.results.uncertainty_kinds import UNCERTAINTY

log = logging.getLogger(__name__)

KINDS_OF_THRESHOLD = ("error", "entropy")  # A threshold is suggested for the first available


@dataclass(frozen=True, slots=True)
class UncertaintyEvaluation:
    """Evaluation of the probabilities and uncertainties of predictions."""

    calibration: CalibrationScores | None  # Scores of the probabilities; None without any
    kinds: dict[str, RankingScores]  # Scores by kind of uncertainty
    accepted: AcceptedPoints | None = None  # Suggested threshold, if all scans have a kind

    def to_json(self) -> dict[str, object]:
        """Return plain data for JSON, without absent parts; null stands for NaN."""
        accepted = self.accepted
        kinds = {kind: asdict(scores) for kind, scores in self.kinds.items()}
        parts = {
            "calibration": self.calibration and plain(self.calibration),
            "uncertainty": {
                kind: {name: plain(value) for name, value in scores.items() if value is not None}
                for kind, scores in kinds.items()
            },
            "accepted": accepted and plain(accepted) | {"sentence": accepted.sentence},
        }
        return {name: part for name, part in parts.items() if part}


def evaluate_uncertainty(counts: ScanCounts) -> UncertaintyEvaluation:
    """Divide the counts of all scans; warn of files that only some of the scans have."""
    for folder in (SOFTMAX, *(f"uncertainty/{kind}" for kind in UNCERTAINTY)):
        if 0 < counts.files[folder] < counts.scans:
            log.warning("only %d of %d scans have %s", counts.files[folder], counts.scans, folder)
    histograms, softmax = counts.histograms, None
    if SOFTMAX in histograms:
        softmax = calibration_scores(histograms[SOFTMAX], counts.calibration_errors)
    diagrams = {"error": reliability(histograms[OF_ERROR].counts)} if OF_ERROR in histograms else {}
    kinds = {
        kind: ranking_scores(histograms[kind], diagrams.get(kind))
        for kind in EVALUATED_KINDS
        if kind in histograms
    }
    error, confidence = kinds.get("error"), kinds.get("least_confidence")
    if counts.accepted:
        error = None  # Only accepted points have it, all points have the softmax.
    if error and confidence and error.aurc > confidence.aurc:
        log.warning("the error ranks labels worse than the confidence: use --reject with care")
    if error and error.ece and softmax and error.ece > softmax.ece:
        log.warning("the error is calibrated worse than the softmax: do not read it as a share")
    accepted = next(
        (
            accepted_points(kind, histogram)
            for kind in KINDS_OF_THRESHOLD
            if counts.files[f"uncertainty/{kind}"] == counts.scans
            and (histogram := histograms.get(kind))
            and histogram.scans
        ),
        None,
    )
    return UncertaintyEvaluation(softmax, kinds, accepted)
