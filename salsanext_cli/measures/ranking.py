# SPDX-License-Identifier: MIT
"""Right and wrong points by uncertainty: the counts behind every figure of ranking.

A bin is a bfloat16 number, to which uncertainties are cut off: 128 bins for every doubling, which
tell 1 from 1.008. Points in one bin are tied. Ranking depends on the order alone, so that figures
from these counts differ from those of the raw values only by pairs of points within a bin.
"""

from __future__ import annotations

from typing import Any, Self

import numpy as np
import numpy.typing as npt

from salsanext_cli.measures.confusion import Ratios
from salsanext_cli.measures.sums import Sums
from salsanext_cli.measures.tally import Tally, require_points

PER_OCTAVE = 128
LOWEST, HIGHEST = -48, 8
"""Powers of two between which bins lie: below are 0 and what float32 could not tell from it."""
BINS = 1 + (HIGHEST - LOWEST) * PER_OCTAVE
"""One for everything up to the lowest, then 128 for every octave; the last is open."""
SHIFT = 16
"""Bits of a float32 that a bfloat16 does not have."""
FIRST = int(np.float32(2.0**LOWEST).view(np.int32)) >> SHIFT


def bin_of(uncertainty: npt.NDArray[Any]) -> npt.NDArray[np.intp]:
    """Return the bin of each uncertainty, from float32, same shape; NaN has none."""
    # The bit patterns of positive floats are in the order of the floats.
    key = uncertainty.astype(np.float32).view(np.int32) >> SHIFT
    bins: npt.NDArray[np.intp] = np.clip(key - FIRST + 1, 0, BINS - 1).astype(np.intp)
    return bins


def highest_of_bins() -> Ratios:
    """Return the largest float32 that each bin holds, (BINS,) float64; the last is open."""
    next_key = (np.arange(BINS, dtype=np.int32) + FIRST) << SHIFT
    highest: Ratios = (next_key - 1).view(np.float32).astype(np.float64)
    highest[-1] = np.inf
    return highest


class Ranking(Tally):
    """Counts by uncertainty; adding two gives the counts of both.

    `sums` holds the ``uncertainty`` of each group.
    """

    __slots__ = ()

    @classmethod
    def none(cls, group_count: int) -> Self:
        """Return the counts of nothing in G groups."""
        return cls(group_count, BINS, {"uncertainty": Sums.none(group_count)})

    def update(
        self,
        uncertainty: npt.NDArray[Any],
        wrong: npt.NDArray[np.bool_],
        group: npt.NDArray[Any],
    ) -> Self:
        """Count the points of a scan.

        Parameters
        ----------
        uncertainty : (N,) float
            Not negative; NaN for points that have none, which are left out.
        wrong : (N,) bool
            Whether the label of each point is not the true one.
        group : (N,) integer
            The group of each point, 0…G-1.

        Returns
        -------
        Ranking
            This one.

        Raises
        ------
        ValueError
            If the arrays do not fit.
        """
        require_points(len(uncertainty), wrong=wrong, group=group)
        known = ~np.isnan(uncertainty)
        values, group = uncertainty[known], group[known]
        self.count(wrong[known], group, bin_of(values))
        self.sums["uncertainty"].update(values.astype(np.float64), group)
        self.left_out += len(known) - len(values)
        return self

    @property
    def means(self) -> Ratios:
        """Mean uncertainty of each group, (G,) float64; NaN for one without points."""
        return self.sums["uncertainty"].means(self.points)
