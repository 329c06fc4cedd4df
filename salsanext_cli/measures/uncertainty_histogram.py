# SPDX-License-Identifier: MIT
"""Histograms of uncertainty, of right and of wrong points.

A bin is a bfloat16 number, to which uncertainties are truncated: 128 bins per octave, which
separate 1 from 1.008. Points in one bin are tied. Ranking depends on the order alone, so that
results from these counts differ from those of the raw values only by pairs of points within a bin.
"""

from __future__ import annotations

from typing import Any, Self

import numpy as np
import numpy.typing as npt

from salsanext_cli.measures.confusion import Mask, Ratios
from salsanext_cli.measures.grouped_histogram import GroupedHistogram

BINS_PER_OCTAVE = 128
LOWEST, HIGHEST = -48, 8
"""Exponents of two of the first and the last bin; uncertainties below are as good as 0."""
BINS = 1 + (HIGHEST - LOWEST) * BINS_PER_OCTAVE
"""Number of bins: one for everything below the lowest, then 128 per octave; the last is open."""
BFLOAT16_SHIFT = 16
"""Bits of a float32 that a bfloat16 does not have."""
FIRST_KEY = int(np.float32(2.0**LOWEST).view(np.int32)) >> BFLOAT16_SHIFT


def bin_of(uncertainty: npt.NDArray[Any]) -> npt.NDArray[np.intp]:
    """Return the bin of each uncertainty, from float32, same shape; NaN has none."""
    # The bit patterns of positive floats are in the order of the floats.
    key = uncertainty.astype(np.float32).view(np.int32) >> BFLOAT16_SHIFT
    bins: npt.NDArray[np.intp] = np.clip(key - FIRST_KEY + 1, 0, BINS - 1).astype(np.intp)
    return bins


def highest_of_bins() -> Ratios:
    """Return the largest float32 that each bin holds, (BINS,) float64; the last is open."""
    next_key = (np.arange(BINS, dtype=np.int32) + FIRST_KEY) << BFLOAT16_SHIFT
    highest: Ratios = (next_key - 1).view(np.float32).astype(np.float64)
    highest[-1] = np.inf
    return highest


class UncertaintyHistogram(GroupedHistogram):
    """Histograms of uncertainty by group, and sums of the uncertainty."""

    BIN_COUNT = BINS
    SUMMED = ("uncertainty",)
    __slots__ = ()

    def update(self, uncertainty: npt.NDArray[Any], wrong: Mask, group: npt.NDArray[Any]) -> Self:
        """Count the points of a scan.

        Parameters
        ----------
        uncertainty : (N,) float
            Not negative; NaN for points without one, which are left out.
        wrong : (N,) bool
            Whether the label of each point is not the true one.
        group : (N,) integer
            The group of each point, 0…G-1.

        Returns
        -------
        UncertaintyHistogram
            This one.

        Raises
        ------
        ValueError
            If the arrays do not fit.
        """
        values = uncertainty.astype(np.float64)
        return self.count(~np.isnan(values), wrong, group, bin_of(uncertainty), uncertainty=values)
