# SPDX-License-Identifier: MIT
"""Evaluation of probabilities and uncertainties: an uncertainty is a detector of wrong points.

Functions of counts take the numbers of right and of wrong points in bins of ascending uncertainty,
(B,) int64. Points of one bin are tied: scores are the mean over every order among them.
"""

import logging
import math
from dataclasses import asdict, dataclass
from typing import Self

import numpy as np

from salsanext_cli.core.measures.calibration import (
    CalibrationScores,
    Reliability,
    calibration_scores,
    reliability,
)
from salsanext_cli.core.measures.counts import EVALUATED_KINDS, OF_ERROR, SOFTMAX, ScanCounts
from salsanext_cli.core.measures.histograms import Histogram, highest_of_bins
from salsanext_cli.core.measures.scores import Counts, Ratios
from salsanext_cli.core.plain_data import plain
from salsanext_cli.core.texts import percentage
from salsanext_cli.core.uncertainty.kinds import UNCERTAINTY
from salsanext_cli.core.wording import argument

log = logging.getLogger(__name__)

COVERAGE = np.arange(1, 101) / 100  # Shares of the least uncertain points
PERCENT_ACCEPTED = 80  # Share of the points, in percent, that the suggested threshold aims at
FEW_DIGITS = (1, 2, 3, 4)  # Significant digits of a rounded threshold
SERIES_FROM = 16  # Harmonic numbers from here on: their series is exact to the last digit
KINDS_OF_THRESHOLD = ("error", "entropy")  # A threshold is suggested for the first available


@dataclass(frozen=True, slots=True, kw_only=True)
class RankingScores:
    """Scores of a kind of uncertainty as a detector of wrong points; NaN where undefined."""

    points: int
    wrong: int  # Number of points whose label is not the true one
    mean: float  # Mean uncertainty
    auroc: float  # Area under the receiver operating characteristic, 0…1; 0.5 is chance
    aupr: float  # Average precision with wrong points as the positives, 0…1; higher is better
    aurc: float  # Area under the risk-coverage curve, 0…1; lower is better
    excess_aurc: float  # Difference to the area of the best order, wrong points last
    # Area between the sparsification curves of this and of the best order, as multiples of the
    # share of wrong points; lower is better
    ause: float
    scans: int  # Number of scans with points
    without_value: int  # Number of points
    risk_coverage: Ratios  # (100,): share of wrong points among the least uncertain 1 %, … 100 %
    thresholds: Ratios  # (100,) float64: largest uncertainty of these points, at most 1 % too large
    ece: float | None = None  # Expected calibration error, 0…1; only of the error, a probability
    reliability: Reliability | None = None  # Its diagram


def ranking_scores(histogram: Histogram, diagram: Reliability | None = None) -> RankingScores:
    """Divide the counts of an `uncertainty_histogram`.

    Parameters
    ----------
    histogram : Histogram
        Right and wrong points by uncertainty.
    diagram : Reliability, optional
        Reliability of the error; None for other kinds of uncertainty.

    Returns
    -------
    RankingScores
    """
    right, wrong = histogram.counts
    points = int(histogram.counts.sum())
    errors = int(wrong.sum())
    area = aurc(right, wrong)
    # In the best order, every wrong point is more uncertain than every right one.
    excess = area - aurc(np.array([right.sum(), 0]), np.array([0, errors]))
    risk, thresholds = risk_coverage(right, wrong)
    return RankingScores(
        points=points,
        wrong=errors,
        mean=histogram.mean("uncertainty"),
        auroc=auroc(right, wrong),
        aupr=average_precision(right, wrong),
        aurc=area,
        excess_aurc=excess,
        ause=excess * points / errors if errors else math.nan,
        scans=histogram.scans,
        without_value=histogram.without_value,
        risk_coverage=risk,
        thresholds=thresholds,
        ece=diagram.error if diagram else None,
        reliability=diagram,
    )


def auroc(right: Counts, wrong: Counts) -> float:
    """Return the chance that a wrong point is more uncertain than a right one, ties half."""
    pairs = float(right.sum()) * float(wrong.sum())
    below = right.cumsum() - right / 2
    return float(wrong @ below / pairs) if pairs else math.nan


def average_precision(right: Counts, wrong: Counts) -> float:
    """Return Σ_t (recall_t − recall_{t−1}) precision_t over thresholds t, descending."""
    true_positives = wrong[::-1].cumsum()
    flagged = true_positives + right[::-1].cumsum()
    held = flagged > 0
    if not wrong.any():
        return math.nan
    precision = true_positives[held] / flagged[held]
    return float(wrong[::-1][held] @ precision / true_positives[-1])


def aurc(right: Counts, wrong: Counts) -> float:
    """Return the mean over k = 1…n of the risk of the k least uncertain points."""
    # The risk is the share of wrong points. Within a bin of m points, w of them wrong, its mean is
    # (E + (k − K) w/m) / k, with E wrong points among the K points of the bins before. The sum over
    # k is closed in harmonic numbers.
    tied = right + wrong
    held = tied > 0
    if not held.any():
        return math.nan
    tied = tied[held]
    errors = wrong[held]
    reached = tied.cumsum()
    errors_before = errors.cumsum() - errors
    before = reached - tied
    rate = errors / tied
    inverse = _harmonic(reached) - _harmonic(before)
    return float((errors + (errors_before - before * rate) * inverse).sum() / reached[-1])


def risk_coverage(
    right: Counts, wrong: Counts, coverage: Ratios = COVERAGE
) -> tuple[Ratios, Ratios]:
    """Return risks and thresholds at coverages.

    Parameters
    ----------
    right : (B,) int64
        Right points in bins of ascending uncertainty.
    wrong : (B,) int64
        Wrong points in these bins.
    coverage : (K,) float64
        Shares of the least uncertain points, 0…1.

    Returns
    -------
    risk : (K,) float64
        Share of wrong points among these; NaN without points.
    thresholds : (K,) float64
        Largest uncertainty of these points; NaN without points.
    """
    reached = (right + wrong).cumsum()
    accepted = coverage * reached[-1]
    if not reached[-1]:
        return np.full(accepted.shape, np.nan), np.full(accepted.shape, np.nan)
    errors = np.interp(accepted, np.append(0, reached), np.append(0, wrong.cumsum()))
    # A share such as 0.07 of 100 points is 7.000000000000001 of them.
    bins = np.searchsorted(reached, np.ceil(accepted - 1e-6))
    return errors / accepted, highest_of_bins()[bins]


def _harmonic(numbers: Counts) -> Ratios:
    """Return 1 + 1/2 + … + 1/n of each n, 0 for 0."""
    small = np.concatenate([[0.0], (1 / np.arange(1, SERIES_FROM)).cumsum()])
    n = np.maximum(numbers, SERIES_FROM).astype(np.float64)
    tail = 1 / (2 * n) - 1 / (12 * n**2) + 1 / (120 * n**4) - 1 / (252 * n**6) + 1 / (240 * n**8)
    series = np.log(n) + np.euler_gamma + tail
    return np.where(numbers < SERIES_FROM, small[np.minimum(numbers, SERIES_FROM - 1)], series)


@dataclass(frozen=True, slots=True, kw_only=True)
class AcceptedPoints:
    """Points whose uncertainty is below a threshold."""

    kind: str  # Kind of uncertainty
    points: int  # Number of points with this uncertainty
    risk_of_all: float  # Share of these points that is wrong, 0…1
    # NaN where no threshold can help: no point is wrong, none is right, or all are tied
    threshold: float = math.nan
    coverage: float = math.nan  # Share of the points below the threshold, exact
    risk: float = math.nan  # Share of the accepted points that is wrong, exact

    @property
    def sentence(self) -> str:
        """Suggested threshold in words."""
        kind = self.kind
        risk_of_all = _percent(self.risk_of_all)
        if math.isnan(self.threshold):
            return (
                f"no threshold of {kind} helps: {risk_of_all} of {self.points:,} points are wrong"
            )
        unit = UNCERTAINTY[kind].unit if kind in UNCERTAINTY else ""
        below = f"{kind} below {self.threshold:.4g} {unit}".rstrip()
        # 99.96 % is not 100 %.
        accepted = f"the {percentage(min(self.coverage, 0.999), figures=3)} of points with {below}"
        risk = _percent(self.risk)
        if self.risk < self.risk_of_all and risk != risk_of_all:
            return f"accept {accepted}: {risk} of them are wrong instead of {risk_of_all}"
        shares = f"{risk} of {accepted} are wrong, {risk_of_all} of all"
        return f"the kind `{kind}` does not detect wrong points: {shares}"


def accepted_points(kind: str, histogram: Histogram) -> AcceptedPoints:
    """Find the threshold whose coverage is nearest to `PERCENT_ACCEPTED`, ties together."""
    right, wrong = histogram.counts
    tied = right + wrong
    reached = tied.cumsum()
    errors = wrong.cumsum()
    points = int(reached[-1])
    risk_of_all = float(errors[-1] / reached[-1])
    held = np.flatnonzero(tied)
    if risk_of_all in (0, 1) or len(held) == 1:
        return AcceptedPoints(kind=kind, points=points, risk_of_all=risk_of_all)
    nearest = np.abs(100 * reached[held[:-1]] - PERCENT_ACCEPTED * points).argmin()
    last, following = held[nearest : nearest + 2]
    highest = highest_of_bins()
    return AcceptedPoints(
        kind=kind,
        points=points,
        risk_of_all=risk_of_all,
        threshold=_between(highest[last], highest[following - 1]),
        coverage=float(reached[last] / points),
        risk=float(errors[last] / reached[last]),
    )


def _between(highest: float, others: float) -> float:
    """Return a number of few digits above `highest`, and at most the next after `others`."""
    lowest_out = float(np.nextafter(np.float32(others), np.float32(np.inf)))
    middle = (highest + lowest_out) / 2
    rounded = (float(f"{middle:.{digits}g}") for digits in FEW_DIGITS)
    return next((number for number in rounded if highest < number <= lowest_out), lowest_out)


def _percent(share: float) -> str:
    return percentage(share) if share >= 0.01 else percentage(share, figures=2)


def _suggested_threshold(counts: ScanCounts) -> AcceptedPoints | None:
    """Return the threshold of the first of `KINDS_OF_THRESHOLD` that all scans have."""
    for kind in KINDS_OF_THRESHOLD:
        histogram = counts.histograms.get(kind)
        if counts.files[f"uncertainty/{kind}"] == counts.scans and histogram and histogram.scans:
            return accepted_points(kind, histogram)
    return None


@dataclass(frozen=True, slots=True, kw_only=True)
class UncertaintyEvaluation:
    """Evaluation of the probabilities and uncertainties of predictions."""

    calibration: CalibrationScores | None  # Scores of the probabilities; None without any
    kinds: dict[str, RankingScores]  # Scores by kind of uncertainty
    # Suggested threshold, if all scans have a kind and the run rejected no labels
    accepted: AcceptedPoints | None = None

    @classmethod
    def from_counts(cls, counts: ScanCounts) -> Self:
        """Divide the counts of all scans; warn of files that only some of the scans have."""
        for folder in [SOFTMAX] + [f"uncertainty/{kind}" for kind in UNCERTAINTY]:
            files = counts.files[folder]
            if 0 < files < counts.scans:
                log.warning("only %d of %d scans have %s", files, counts.scans, folder)
        histograms = counts.histograms
        softmax = None
        diagram = None
        if SOFTMAX in histograms:
            softmax = calibration_scores(histograms[SOFTMAX], counts.calibration_errors)
        if OF_ERROR in histograms:
            diagram = reliability(histograms[OF_ERROR].counts)
        kinds = {
            kind: ranking_scores(histograms[kind], diagram if kind == "error" else None)
            for kind in EVALUATED_KINDS
            if kind in histograms
        }
        error = kinds.get("error")
        confidence = kinds.get("least_confidence")
        if counts.accepted:
            error = None  # Only accepted points have it, all points have the softmax.
        if error and confidence and error.aurc > confidence.aurc:
            text = "the error ranks labels worse than the confidence: use %s with care"
            log.warning(text, argument("reject"))
        if error and error.ece and softmax and error.ece > softmax.ece:
            log.warning("the error is calibrated worse than the softmax: do not read it as a share")
        # A run that rejected labels has a threshold already.
        accepted = None if counts.accepted else _suggested_threshold(counts)
        return cls(calibration=softmax, kinds=kinds, accepted=accepted)

    def to_json(self) -> dict[str, object]:
        """Return plain data for JSON; null stands for NaN and for absent parts."""
        accepted = self.accepted
        kinds = {kind: asdict(scores) for kind, scores in self.kinds.items()}
        return {
            "calibration": self.calibration and plain(self.calibration),
            "uncertainty": {
                kind: {name: plain(value) for name, value in scores.items() if value is not None}
                for kind, scores in kinds.items()
            },
            "accepted": accepted and plain(accepted) | {"sentence": accepted.sentence},
        }
