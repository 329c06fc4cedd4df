# SPDX-License-Identifier: MIT
"""Reliability diagram and calibration errors, from counts by confidence.

Probabilities are float16 on disk, and there are 15 361 such numbers from 0 to 1. Points are counted
in a bin for each of these, so that errors are exact for any number of scans.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from salsanext_cli.measures.confusion import Counts, Ratios, ratio

CONFIDENCES = np.arange(int(np.float16(1).view(np.uint16)) + 1).astype(np.uint16).view(np.float16)
"""Every float16 from 0 to 1, ascending: the bit patterns of numbers above 0 are in their order."""
POOLED_BINS = 15
"""Number of bins of the pooled errors and of the diagram."""
SCAN_BINS = 10
"""Number of bins of the error of a single scan, as in Calib3D."""


@dataclass(frozen=True, slots=True)
class Reliability:
    """A reliability diagram: bin b of B holds the confidences above b/B up to (b + 1)/B.

    Attributes
    ----------
    points : (B,) int64
        Number of points in each bin.
    confidence : (B,) float64
        Their mean confidence; NaN for a bin without points.
    accuracy : (B,) float64
        Share of them that is right; NaN for a bin without points.
    """

    points: Counts
    confidence: Ratios
    accuracy: Ratios

    @property
    def error(self) -> float:
        """Expected calibration error, Σ_b n_b/n · |accuracy_b − confidence_b|; NaN if empty."""
        held = self.points > 0
        gaps = np.abs(self.accuracy - self.confidence)[held]
        return float(self.points[held] @ gaps / self.points.sum()) if held.any() else math.nan


def reliability(counts: Counts, bin_count: int = POOLED_BINS) -> Reliability:
    """Sum up counts by confidence in bins of equal width.

    Parameters
    ----------
    counts : (2, 15361) int64
        Right points, then wrong ones, by index into `CONFIDENCES`.
    bin_count : int
        B, the number of bins.
    """
    values = CONFIDENCES.astype(np.float64)
    # The product is exact: a float16 has 11 binary digits.
    place = np.maximum(np.ceil(values * bin_count).astype(np.intp) - 1, 0)
    starts = np.searchsorted(place, np.arange(bin_count))
    points = np.add.reduceat(counts.sum(axis=0), starts)
    hits = np.add.reduceat(counts[0], starts)
    confidence = np.add.reduceat(counts.sum(axis=0) * values, starts)
    return Reliability(points, ratio(confidence, points), ratio(hits, points))


def adaptive_error(counts: Counts, bin_count: int = POOLED_BINS) -> float:
    """Return the calibration error over bins that hold equally many points each.

    Points of one confidence that a border falls among are divided in proportion, right and wrong
    alike.

    Parameters
    ----------
    counts : (2, 15361) int64
        Right points, then wrong ones, by index into `CONFIDENCES`.
    bin_count : int
        B, the number of bins.

    Returns
    -------
    float
        Σ_b |accuracy_b − confidence_b| / B; NaN without points.
    """
    points = counts.sum(axis=0)
    held = points > 0
    if not held.any():
        return math.nan
    gaps = counts[0, held] - points[held] * CONFIDENCES[held].astype(np.float64)
    reached = np.concatenate([[0], points[held].cumsum()])
    borders = np.linspace(0, reached[-1], bin_count + 1)
    gap = np.diff(np.interp(borders, reached, np.concatenate([[0], gaps.cumsum()])))
    return float(np.abs(gap).sum() / reached[-1])
