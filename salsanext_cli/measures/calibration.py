# SPDX-License-Identifier: MIT
"""How far probabilities can be taken at their word.

The confidence of a point is its largest probability, and the point is right if the class that has
it is the true one. So the softmax itself is judged, before neighbours have voted; the label in
``predictions/`` may be another.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from salsanext_cli.measures.confusion import Ratios
from salsanext_cli.measures.reliability import CONFIDENCES, adaptive_error, reliability
from salsanext_cli.measures.sums import Sums
from salsanext_cli.measures.tally import Tally, require_points

SMALLEST = 2.0**-24
"""What the probability of the true class is at least taken as: the smallest float16 above 0.

A probability below half of it is 0 on disk, and one such point would make the mean infinite. So a
point costs at most 24 ln 2 = 16.6 nats.
"""
SCAN_BINS = 10
"""Bins of the error of a single scan, as Calib3D has it."""


@dataclass(frozen=True, slots=True)
class Judged:
    """What the truth says of the softmax of points, each (N,); NaN for points that have none.

    Attributes
    ----------
    predicted : intp
        The most probable class.
    wrong : bool
        Whether that is not the true one.
    confidence : float16
        The largest probability.
    nll : float64
        Negative log-likelihood of the true class in nats, 0…16.6.
    brier : float64
        Squared distance Σ_c (p_c − [c is true])², 0…2.
    """

    predicted: npt.NDArray[np.intp]
    wrong: npt.NDArray[np.bool_]
    confidence: npt.NDArray[np.float16]
    nll: Ratios
    brier: Ratios


def judge(probabilities: npt.NDArray[Any], truth: npt.NDArray[Any]) -> Judged:
    """Hold probabilities against the truth.

    Parameters
    ----------
    probabilities : (N, C) float
        Softmax; rows of NaN for points that have none.
    truth : (N,) integer
        Train ids, 0…C-1.

    Raises
    ------
    ValueError
        If the arrays do not fit.
    """
    require_points(len(probabilities), truth=truth)
    exact = probabilities.astype(np.float64)
    every = np.arange(len(exact))
    of_truth, predicted = exact[every, truth], exact.argmax(axis=1)
    return Judged(
        predicted=predicted,
        wrong=predicted != truth,
        confidence=exact[every, predicted].astype(np.float16),
        nll=-np.log(np.maximum(of_truth, SMALLEST)),
        brier=np.einsum("nc,nc->n", exact, exact) - 2 * of_truth + 1,
    )


class Calibration(Tally):
    """Counts by confidence; adding two gives the counts of both.

    `sums` holds the negative log-likelihood ``nll`` and the ``brier`` score of each group, and
    ``scan_errors``, the calibration errors of the scans.
    """

    __slots__ = ()

    @classmethod
    def none(cls, group_count: int) -> Self:
        """Return the counts of nothing in G groups."""
        by_group = {name: Sums.none(group_count) for name in ("nll", "brier")}
        return cls(group_count, len(CONFIDENCES), by_group | {"scan_errors": Sums.none(1)})

    def update(self, judged: Judged, group: npt.NDArray[Any]) -> Self:
        """Count the points of a scan.

        Parameters
        ----------
        judged : Judged
            The softmax of N points.
        group : (N,) integer
            The group of each point, 0…G-1.

        Returns
        -------
        Calibration
            This one.

        Raises
        ------
        ValueError
            If the arrays do not fit.
        """
        require_points(len(judged.confidence), group=group)
        known = ~np.isnan(judged.confidence)
        group = group[known]
        bits = judged.confidence[known].view(np.uint16).astype(np.intp)
        counted = self.count(judged.wrong[known], group, bits).sum(axis=1)
        self.sums["nll"].update(judged.nll[known], group)
        self.sums["brier"].update(judged.brier[known], group)
        if known.any():
            error = reliability(counted, SCAN_BINS).error
            self.sums["scan_errors"].update(np.array([error]), np.zeros(1, np.intp))
        self.left_out += int((~known).sum())
        return self

    @property
    def scan_error(self) -> float:
        """Expected calibration error of a scan, 10 bins, mean over the scans; NaN without any."""
        return float(self.sums["scan_errors"].means(np.array([self.scans]))[0])


@dataclass(frozen=True, slots=True)
class CalibrationScores:
    """How well the probabilities of a set of points are calibrated; NaN without points.

    Attributes
    ----------
    points : int
        Number of points.
    confidence : float
        Mean confidence, 0…1.
    accuracy : float
        Share of the points whose most probable class is the true one, 0…1.
    nll : float
        Mean negative log-likelihood of the true class in nats, 0…16.6; lower is better.
    brier : float
        Mean squared distance Σ_c (p_c − [c is true])², 0…2; lower is better.
    ece : float
        Expected calibration error over 15 bins of equal width, 0…1; lower is better.
    ace : float
        The same over 15 bins of equally many points; lower is better.
    """

    points: int
    confidence: float
    accuracy: float
    nll: float
    brier: float
    ece: float
    ace: float


def calibration_scores(calibration: Calibration) -> CalibrationScores:
    """Divide the counts of all groups together."""
    pooled = calibration.total()
    counts, points = pooled.counts[:, 0], pooled.points
    total = int(points[0])
    held = counts.sum(axis=0) @ CONFIDENCES.astype(np.float64)
    return CalibrationScores(
        points=total,
        confidence=float(held / total) if total else math.nan,
        accuracy=float(counts[0].sum() / total) if total else math.nan,
        nll=float(pooled.sums["nll"].means(points)[0]),
        brier=float(pooled.sums["brier"].means(points)[0]),
        ece=reliability(counts).error,
        ace=adaptive_error(counts),
    )
