# SPDX-License-Identifier: MIT
"""Calibration of probabilities: confidence against accuracy, log-likelihood, Brier score."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from salsanext_cli.core.measures.histograms import CONFIDENCES, Histogram
from salsanext_cli.core.measures.scores import Counts, Ratios, ratio

POOLED_BINS = 15  # Number of bins of the pooled errors and of the diagram
SCAN_BINS = 10  # Number of bins of the error of a single scan, as in Calib3D


@dataclass(frozen=True, slots=True, kw_only=True)
class Reliability:
    """Reliability diagram: bin b of B contains the confidences above b/B up to (b + 1)/B."""

    points: Counts  # (B,) int64
    confidence: Ratios  # (B,) float64: mean confidence; NaN for a bin without points
    accuracy: Ratios  # (B,) float64: share of right points; NaN for a bin without points

    @property
    def error(self) -> float:
        """Expected calibration error, Σ_b n_b/n · |accuracy_b − confidence_b|; NaN if empty."""
        filled = self.points > 0
        gaps = np.abs(self.accuracy - self.confidence)[filled]
        return float(self.points[filled] @ gaps / self.points.sum()) if filled.any() else math.nan


def reliability(counts: Counts, bin_count: int = POOLED_BINS) -> Reliability:
    """Sum counts by index into `CONFIDENCES`, (2, 15361), in bins of equal width."""
    values = CONFIDENCES.astype(np.float64)
    # The product is exact: a float16 has 11 binary digits.
    diagram_bin = np.maximum(np.ceil(values * bin_count).astype(np.intp) - 1, 0)
    starts = np.searchsorted(diagram_bin, np.arange(bin_count))
    points = np.add.reduceat(counts.sum(axis=0), starts)
    hits = np.add.reduceat(counts[0], starts)
    confidence = np.add.reduceat(counts.sum(axis=0) * values, starts)
    return Reliability(
        points=points, confidence=ratio(confidence, points), accuracy=ratio(hits, points)
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationScores:
    """Calibration of the probabilities of the points of some scans; NaN without points."""

    points: int
    nll: float  # Mean negative log-likelihood of the true class in nats, 0…16.6; lower is better
    brier: float  # Mean squared distance Σ_c (p_c − [c is true])², 0…2; lower is better
    ece: float  # Expected calibration error over 15 bins of equal width, 0…1; lower is better
    scans: int  # Number of scans with points
    without_value: int  # Number of points
    ece_per_scan: float  # Expected calibration error of a scan over 10 bins, mean over the scans
    reliability: Reliability  # The diagram over 15 bins


def calibration_scores(
    histogram: Histogram, scan_errors: Sequence[float] = ()
) -> CalibrationScores:
    """Divide the counts of a `confidence_histogram`, and the sum of the errors of its scans."""
    diagram = reliability(histogram.counts)
    return CalibrationScores(
        points=int(histogram.counts.sum()),
        nll=histogram.mean("nll"),
        brier=histogram.mean("brier"),
        ece=diagram.error,
        scans=histogram.scans,
        without_value=histogram.without_value,
        ece_per_scan=math.fsum(scan_errors) / len(scan_errors) if scan_errors else math.nan,
        reliability=diagram,
    )
