# SPDX-License-Identifier: MIT
"""Objective of a dropout rate: how well total variances explain errors (arXiv 1907.06890)."""

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.errors import UsageError
from salsanext_cli.records import Float

SMALLEST_VARIANCE = 1e-4
"""Lower bound of a variance: a standard deviation of 1 % of probability.

Without it a few points that are sure and wrong would weigh more than all others.
"""


def rates_between(lowest: float, highest: float, steps: int) -> list[float]:
    """Return rates at equal steps of their logarithm, both ends included."""
    for option, rate in (("--lowest", lowest), ("--highest", highest)):
        if not 0 < rate < 1:
            raise UsageError(option, f"{rate:g}", "a dropout rate above 0 and below 1")
    if not lowest < highest:
        raise UsageError("--lowest", f"{lowest:g}", f"less than --highest, {highest:g}")
    if steps < 2:
        raise UsageError("--steps", str(steps), "at least 2")
    inner = np.geomspace(lowest, highest, steps)[1:-1].tolist()
    return [lowest, *inner, highest]


def objective(probabilities: Float, variance: Float, truth: npt.NDArray[Any]) -> float:
    """Return Σ ½ log s + (y − p)² / 2s over points and classes; lower is better.

    It is the negative log-likelihood, but for a constant, of the one-hot truth y (M,) under
    Gaussians of mean p (M, C), the mean softmax over the passes, and variance s (M, C), their total
    variance; smaller ones count as `SMALLEST_VARIANCE`.
    """
    s = np.maximum(variance.astype(np.float64), SMALLEST_VARIANCE)
    error = probabilities.astype(np.float64)
    error[np.arange(len(truth)), truth] -= 1
    return math.fsum((np.log(s) / 2 + error**2 / (2 * s)).sum(axis=0))
