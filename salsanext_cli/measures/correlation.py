# SPDX-License-Identifier: MIT
"""Spearman's rank correlation."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt


def spearman(one: npt.NDArray[Any], other: npt.NDArray[Any]) -> float:
    """Return Spearman's rank correlation, the linear correlation of the ranks.

    Parameters
    ----------
    one, other : (N,)
        Finite numbers; equal ones share the mean of their ranks.

    Returns
    -------
    float
        -1…1; NaN where one of the two does not vary.
    """
    ranks = [_centred_ranks(values) for values in (one, other)]
    norm = math.prod(math.sqrt(r @ r) for r in ranks)
    return float(ranks[0] @ ranks[1] / norm) if norm else math.nan


def _centred_ranks(values: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    """Return ranks whose mean is 0, so that those of equal values are exactly 0."""
    _, place, count = np.unique(values, return_inverse=True, return_counts=True)
    ranks: npt.NDArray[np.float64] = (count.cumsum() - (count + len(values)) / 2)[place]
    return ranks
