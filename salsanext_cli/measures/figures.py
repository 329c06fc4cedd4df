# SPDX-License-Identifier: MIT
"""Figures of calibration and of uncertainty: of all points, by class and by distance."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any, TypeVar

import numpy as np

from salsanext_cli.classes import LabelSpace
from salsanext_cli.measures.calibration import (
    Calibration,
    CalibrationScores,
    calibration_scores,
)
from salsanext_cli.measures.confusion import Ratios
from salsanext_cli.measures.correlation import spearman
from salsanext_cli.measures.distance import RING_NAMES
from salsanext_cli.measures.ranking import Ranking, highest_of_bins
from salsanext_cli.measures.reliability import Reliability, reliability
from salsanext_cli.measures.risk_coverage import (
    RankingScores,
    ranking_scores,
    risk_at,
    threshold_at,
)
from salsanext_cli.measures.scores import plain
from salsanext_cli.measures.tally import Tally

COVERAGE = np.arange(1, 101) / 100
"""Where a risk-coverage curve is drawn: shares of the points, the least uncertain ones first."""

Counted = TypeVar("Counted", bound=Tally)
Figures = TypeVar("Figures")


@dataclass(frozen=True, slots=True)
class CalibrationFigures:
    """How well probabilities are calibrated.

    Attributes
    ----------
    scores : CalibrationScores
        Over all points.
    scan_error : float
        Expected calibration error of a scan over 10 bins, mean over the scans, 0…1.
    scans, left_out : int
        Number of scans with points, and of points without a softmax.
    reliability : Reliability
        The diagram over 15 bins.
    classes : dict of int to CalibrationScores
        By train id of the most probable class, since of these points a calibrated network is
        right as often as it says; of the points that truly are of a class it need not be.
    rings : dict of str to CalibrationScores
        By name of the ring of distance; empty if not wanted.
    """

    scores: CalibrationScores
    scan_error: float
    scans: int
    left_out: int
    reliability: Reliability
    classes: dict[int, CalibrationScores]
    rings: dict[str, CalibrationScores]

    def to_dict(self, space: LabelSpace) -> dict[str, Any]:
        """Return plain data for JSON; null stands for NaN."""
        diagram = {k: v.tolist() for k, v in asdict(self.reliability).items()}
        return {
            "scans": self.scans,
            "left_out": self.left_out,
            **_plain_scores(self.scores),
            "ece_per_scan": plain(self.scan_error),
            "reliability": {k: [plain(v) for v in values] for k, values in diagram.items()},
            **_plain_groups(self.classes, self.rings, space),
        }


@dataclass(frozen=True, slots=True)
class UncertaintyFigures:
    """How well one kind of uncertainty finds wrong points.

    Attributes
    ----------
    scores : RankingScores
        Over all points.
    scans, left_out : int
        Number of scans with points, and of points without a value.
    risk : (100,) float64
        Share of wrong points among the least uncertain 1 %, 2 %, … 100 %.
    thresholds : (100,) float64
        The uncertainty up to which these points go, at most 1 % too large.
    classes : dict of int to RankingScores
        By train id of the true class.
    rings : dict of str to RankingScores
        By name of the ring of distance; empty if not wanted.
    correlation : float
        Spearman's rank correlation, over the classes present, of the mean uncertainty of a class
        and its number of points, -1…1.
    """

    scores: RankingScores
    scans: int
    left_out: int
    risk: Ratios
    thresholds: Ratios
    classes: dict[int, RankingScores]
    rings: dict[str, RankingScores]
    correlation: float

    def to_dict(self, space: LabelSpace) -> dict[str, Any]:
        """Return plain data for JSON; null stands for NaN."""
        return {
            "scans": self.scans,
            "left_out": self.left_out,
            **_plain_scores(self.scores),
            "class_size_correlation": plain(self.correlation),
            "risk_coverage": [plain(risk) for risk in self.risk.tolist()],
            "thresholds": [plain(threshold) for threshold in self.thresholds.tolist()],
            **_plain_groups(self.classes, self.rings, space),
        }


def _plain_scores(scores: CalibrationScores | RankingScores) -> dict[str, Any]:
    return {name: plain(value) for name, value in asdict(scores).items()}


def _plain_groups(
    classes: Mapping[int, CalibrationScores | RankingScores],
    rings: Mapping[str, CalibrationScores | RankingScores],
    space: LabelSpace,
) -> dict[str, Any]:
    return {
        "classes": [
            {"name": space.names[i], "train_id": i, **_plain_scores(of_class)}
            for i, of_class in classes.items()
        ],
        "by_distance": {name: _plain_scores(ring) for name, ring in rings.items()},
    }


def calibration_figures(
    by_class: Calibration, by_ring: Calibration | None, space: LabelSpace
) -> CalibrationFigures:
    """Divide counts of points by their most probable class and, if wanted, by ring."""
    return CalibrationFigures(
        scores=calibration_scores(by_class),
        scan_error=by_class.scan_error,
        scans=by_class.scans,
        left_out=by_class.left_out,
        reliability=reliability(by_class.total().counts[:, 0]),
        classes=_of_groups(calibration_scores, by_class, _scored(space)),
        rings=_of_rings(calibration_scores, by_ring),
    )


def uncertainty_figures(
    by_class: Ranking, by_ring: Ranking | None, space: LabelSpace
) -> UncertaintyFigures:
    """Divide counts of points by their true class and, if wanted, by ring."""
    present = by_class.points > 0
    right, wrong = by_class.total().counts[:, 0]
    return UncertaintyFigures(
        scores=ranking_scores(by_class),
        scans=by_class.scans,
        left_out=by_class.left_out,
        risk=risk_at(right, wrong, COVERAGE),
        thresholds=threshold_at(right, wrong, COVERAGE, highest_of_bins()),
        classes=_of_groups(ranking_scores, by_class, _scored(space)),
        rings=_of_rings(ranking_scores, by_ring),
        correlation=spearman(by_class.means[present], by_class.points[present]),
    )


def _scored(space: LabelSpace) -> list[int]:
    return [int(i) for i in np.flatnonzero(space.scored)]


def _of_groups(
    divide: Callable[[Counted], Figures], counts: Counted, groups: Iterable[int]
) -> dict[int, Figures]:
    return {i: divide(counts.group(i)) for i in groups}


def _of_rings(divide: Callable[[Counted], Figures], counts: Counted | None) -> dict[str, Figures]:
    if counts is None:
        return {}
    return {name: divide(counts.group(i)) for i, name in enumerate(RING_NAMES)}
