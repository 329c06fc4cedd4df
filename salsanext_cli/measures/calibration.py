# SPDX-License-Identifier: MIT
"""Calibration of probabilities: confidence against accuracy, log-likelihood, Brier score.

The confidence of a point is its largest probability, and the point is right if the class of that
probability is the true one. So the softmax itself is evaluated, before the vote of the neighbours;
the label in ``predictions/`` may be another.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from salsanext_cli.measures.confusion import Mask, Ratios
from salsanext_cli.measures.grouped_histogram import GroupedHistogram, require_points
from salsanext_cli.measures.reliability import CONFIDENCES, adaptive_error, reliability

SMALLEST_PROBABILITY = 2.0**-24
"""Least probability of the true class: the smallest float16 above 0.

A probability below half of it is 0 on disk, and one such point would make the mean infinite. So a
point costs at most 24 ln 2 = 16.6 nats.
"""


@dataclass(frozen=True, slots=True)
class SoftmaxErrors:
    """Errors of the softmax of points, each (N,); NaN for points that have none.

    Attributes
    ----------
    predicted : intp
        The most probable class.
    wrong : bool
        Whether the true class is another.
    confidence : float16
        The largest probability.
    nll : float64
        Negative log-likelihood of the true class in nats, 0…16.6.
    brier : float64
        Squared distance Σ_c (p_c − [c is true])², 0…2.
    """

    predicted: npt.NDArray[np.intp]
    wrong: Mask
    confidence: npt.NDArray[np.float16]
    nll: Ratios
    brier: Ratios


def softmax_errors(probabilities: npt.NDArray[Any], truth: npt.NDArray[Any]) -> SoftmaxErrors:
    """Compare probabilities with the truth.

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
    return SoftmaxErrors(
        predicted=predicted,
        wrong=predicted != truth,
        confidence=exact[every, predicted].astype(np.float16),
        nll=-np.log(np.maximum(of_truth, SMALLEST_PROBABILITY)),
        brier=np.einsum("nc,nc->n", exact, exact) - 2 * of_truth + 1,
    )


class ConfidenceHistogram(GroupedHistogram):
    """Histograms of confidence by group, a bin for each of `CONFIDENCES`, and sums of errors."""

    BIN_COUNT = len(CONFIDENCES)
    SUMMED = ("nll", "brier")
    __slots__ = ()

    def update(self, errors: SoftmaxErrors, group: npt.NDArray[Any]) -> Self:
        """Count the points of a scan.

        Parameters
        ----------
        errors : SoftmaxErrors
            Errors of N points.
        group : (N,) integer
            The group of each point, 0…G-1.

        Returns
        -------
        ConfidenceHistogram
            This one.

        Raises
        ------
        ValueError
            If the arrays do not fit.
        """
        bins = errors.confidence.view(np.uint16).astype(np.intp)
        known = ~np.isnan(errors.confidence)
        return self.count(known, errors.wrong, group, bins, nll=errors.nll, brier=errors.brier)


@dataclass(frozen=True, slots=True)
class CalibrationScores:
    """Calibration of the probabilities of a set of points; NaN without points.

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


def calibration_scores(histogram: ConfidenceHistogram) -> CalibrationScores:
    """Divide the counts of all groups together."""
    pooled = histogram.total()
    counts, total = pooled.counts[:, 0], int(pooled.points[0])
    confidence = counts.sum(axis=0) @ CONFIDENCES.astype(np.float64)
    return CalibrationScores(
        points=total,
        confidence=float(confidence / total) if total else math.nan,
        accuracy=float(counts[0].sum() / total) if total else math.nan,
        nll=float(pooled.means("nll")[0]),
        brier=float(pooled.means("brier")[0]),
        ece=reliability(counts).error,
        ace=adaptive_error(counts),
    )
