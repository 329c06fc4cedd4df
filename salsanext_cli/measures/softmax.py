# SPDX-License-Identifier: MIT
"""Errors of the softmax of points, and uncertainties that follow from a single softmax."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.measures.confusion import Mask, Ratios
from salsanext_cli.records import Float

SMALLEST_PROBABILITY = 2.0**-24
"""Least probability of the true class: the smallest float16 above 0.

A probability below half of it is 0 on disk, and one such point would make the mean infinite. So a
point costs at most 24 ln 2 = 16.6 nats.
"""


@dataclass(frozen=True, slots=True)
class SoftmaxErrors:
    """Errors of the softmax of points, each (N,); NaN for points that have none."""

    predicted: npt.NDArray[np.intp]  # The most probable class
    wrong: Mask  # Whether the true class is another
    confidence: npt.NDArray[np.float16]  # The largest probability
    nll: Ratios  # Negative log-likelihood of the true class in nats, 0…16.6
    brier: Ratios  # Squared distance Σ_c (p_c − [c is true])², 0…2


def softmax_errors(probabilities: npt.NDArray[Any], truth: npt.NDArray[Any]) -> SoftmaxErrors:
    """Compare probabilities with the truth.

    `probabilities` (N, C) float, softmax; rows of NaN for points that have none; `truth` (N,)
    integer, train ids, 0…C-1.
    """
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


def lack_of_confidence(probabilities: npt.NDArray[Any]) -> Float:
    """Return 1 − the largest probability: (N, C) to (N,) float32, 0 … 1 − 1/C.

    It is the sum of the others, which float16 resolves finely where 1 − 0.9999 would be 0.
    """
    others = probabilities.astype(np.float32)
    others[np.arange(len(others)), others.argmax(axis=1)] = 0
    rest: Float = np.einsum("nc->n", others)
    return rest


def softmax_entropy(probabilities: npt.NDArray[Any]) -> Float:
    """Return the entropy −Σ_c p_c ln p_c in nats: (N, C) to (N,) float32, 0 … ln C."""
    some = probabilities.astype(np.float32)
    # 0 ln 0 is 0, and no float16 above 0 is smaller.
    logarithm = np.log(np.clip(some, SMALLEST_PROBABILITY, 1))
    entropy: Float = -np.einsum("nc,nc->n", some, logarithm)
    return np.maximum(entropy, 0)
