# SPDX-License-Identifier: MIT
"""Histograms of confidence and of uncertainty, of right and of wrong points.

Probabilities are float16 on disk: a bin for each of the 15 361 such numbers from 0 to 1 makes
errors exact for any number of scans. A bin of uncertainty is a bfloat16 number, to which
uncertainties are truncated: 128 bins per octave, which separate 1 from 1.008. Points of one bin
are tied.

The confidence of a point is its largest probability. The point is right if the class of that
probability is the true one, so the softmax is evaluated before the vote of the neighbours.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.measures.scores import Counts, Ratios
from salsanext_cli.core.records import Float, Indices, Mask

MIN_PROBABILITY = 2.0**-24
"""Least probability of the true class, the smallest float16 above 0, which costs 16.6 nats."""
CONFIDENCES = np.arange(int(np.float16(1).view(np.uint16)) + 1).astype(np.uint16).view(np.float16)
"""Every float16 from 0 to 1, ascending: the bit patterns of numbers above 0 are in their order."""
BINS_PER_OCTAVE = 128
LOWEST = -48  # Exponent of two of the first bin
HIGHEST = 8  # Exponent of two of the last bin
# One bin for everything below the lowest, then 128 per octave; the last is open.
UNCERTAINTY_BINS = 1 + (HIGHEST - LOWEST) * BINS_PER_OCTAVE
BFLOAT16_SHIFT = 16  # Bits of a float32 that a bfloat16 does not have
FIRST_KEY = int(np.float32(2.0**LOWEST).view(np.int32)) >> BFLOAT16_SHIFT


def lack_of_confidence(probabilities: npt.NDArray[Any]) -> Float:
    """Return 1 − the largest probability, as the sum of the others: (N, C) to (N,) float32."""
    others = probabilities.astype(np.float32)
    others[np.arange(len(others)), others.argmax(axis=1)] = 0
    return np.einsum("nc->n", others)


def softmax_entropy(probabilities: npt.NDArray[Any]) -> Float:
    """Return the entropy −Σ_c p_c ln p_c in nats: (N, C) to (N,) float32, 0 … ln C."""
    probabilities = probabilities.astype(np.float32)
    # 0 ln 0 is 0, and no float16 above 0 is smaller.
    logarithm = np.log(np.clip(probabilities, MIN_PROBABILITY, 1))
    entropy: Float = -np.einsum("nc,nc->n", probabilities, logarithm)
    return np.maximum(entropy, 0)


@dataclass(slots=True, kw_only=True)
class Histogram:
    """Histogram of the points of some scans, and sums of values over them."""

    counts: Counts  # (2, B) int64: right and wrong points by bin
    # By name, the sum of each scan. `math.fsum` adds them for a mean, which is then the same to the
    # last digit in any order of the scans
    scan_sums: dict[str, list[float]]
    scans: int  # Number of scans with a counted point
    without_value: int  # Number of points

    def mean(self, name: str) -> float:
        """Return the mean over the points; NaN without any."""
        points = int(self.counts.sum())
        return math.fsum(self.scan_sums[name]) / points if points else math.nan

    def __iadd__(self, other: Histogram) -> Histogram:
        """Add the counts of other scans."""
        self.counts += other.counts
        for name, sums in self.scan_sums.items():
            sums.extend(other.scan_sums[name])
        self.scans += other.scans
        self.without_value += other.without_value
        return self


def confidence_histogram(probabilities: npt.NDArray[Any], truth: npt.NDArray[Any]) -> Histogram:
    """Count points by confidence, in a bin for each of `CONFIDENCES`, with sums of their errors.

    Parameters
    ----------
    probabilities : (N, C) array
        Softmax of the points, NaN for points to skip.
    truth : (N,) array
        True train ids.

    Returns
    -------
    Histogram
        With the sums `nll`, the negative log-likelihood of the true class in nats, 0…16.6, and
        `brier`, Σ_c (p_c − [c is true])², 0…2.
    """
    exact = probabilities.astype(np.float64)
    rows = np.arange(len(exact))
    true_probability = exact[rows, truth]
    predicted = exact.argmax(axis=1)
    confidence = exact[rows, predicted].astype(np.float16)
    nll = -np.log(np.maximum(true_probability, MIN_PROBABILITY))
    brier = np.einsum("nc,nc->n", exact, exact) - 2 * true_probability + 1
    has_value = ~np.isnan(confidence)
    bins = confidence.view(np.uint16)
    sums = {"nll": nll, "brier": brier}
    return _histogram(len(CONFIDENCES), has_value, predicted != truth, bins, sums)


def uncertainty_histogram(uncertainty: npt.NDArray[Any], wrong: Mask) -> Histogram:
    """Count the points of a scan by uncertainty (N,), 0 and above; skip NaN."""
    values = uncertainty.astype(np.float64)
    bins = bin_of(uncertainty)
    sums = {"uncertainty": values}
    return _histogram(UNCERTAINTY_BINS, ~np.isnan(values), wrong, bins, sums)


def error_histogram(error: npt.NDArray[Any], wrong: Mask) -> Histogram:
    """Count points by the probability (N,) that their label is wrong, in bins of `CONFIDENCES`."""
    # The error claims that the label is wrong, so a wrong point counts as right here.
    bins = np.abs(error).astype(np.float16).view(np.uint16)
    return _histogram(len(CONFIDENCES), ~np.isnan(error), ~wrong, bins, {})


def _histogram(
    bin_count: int,
    has_value: Mask,
    wrong: Mask,
    bins: npt.NDArray[Any],
    values: Mapping[str, Ratios],
) -> Histogram:
    """Count the points of a scan that have a value, all arrays (N,)."""
    cell = np.where(wrong, bin_count, 0)[has_value] + bins[has_value]
    counts = np.bincount(cell, minlength=2 * bin_count).reshape(2, bin_count)
    sums = {name: [float(numbers[has_value].sum())] for name, numbers in values.items()}
    return Histogram(
        counts=counts,
        scan_sums=sums,
        scans=int(len(cell) > 0),
        without_value=len(has_value) - len(cell),
    )


def bin_of(uncertainty: npt.NDArray[Any]) -> Indices:
    """Return the bins of uncertainties other than NaN, in the same shape."""
    # The bit patterns of positive floats are in the order of the floats.
    key = uncertainty.astype(np.float32).view(np.int32) >> BFLOAT16_SHIFT
    return np.clip(key.astype(np.intp) - FIRST_KEY + 1, 0, UNCERTAINTY_BINS - 1)


def highest_of_bins() -> Ratios:
    """Return the largest float32 of each bin, (B,) float64; infinite for the last bin."""
    next_key = (np.arange(UNCERTAINTY_BINS, dtype=np.int32) + FIRST_KEY) << BFLOAT16_SHIFT
    highest: Ratios = (next_key - 1).view(np.float32).astype(np.float64)
    highest[-1] = np.inf
    return highest
