# SPDX-License-Identifier: MIT
"""Uncertainties that follow from a single softmax, to compare others with."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.records import Float


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
    # 0 ln 0 is 0, and no float16 above 0 is smaller than 2⁻²⁴.
    logarithm = np.log(np.clip(some, 2.0**-24, 1))
    entropy: Float = -np.einsum("nc,nc->n", some, logarithm)
    return np.maximum(entropy, 0)
