# SPDX-License-Identifier: MIT
"""Histograms of right and of wrong points by group, and sums per scan."""

from __future__ import annotations

import math
from array import array
from typing import Any, ClassVar, Self

import numpy as np
import numpy.typing as npt

from salsanext_cli.measures.confusion import Counts, Mask, Ratios


class GroupedHistogram:
    """Histograms by group, and sums of values over the points of each group.

    Parameters
    ----------
    group_count : int
        G. Groups are classes, rings of distance, or just one.

    Attributes
    ----------
    counts : (2, G, B) int64
        Number of points by bin; those that are right first, then those that are wrong.
    scan_sums : dict of str to array
        By name in `SUMMED`, G float64 sums for each scan. `math.fsum` adds them for a mean, which
        is then the same to the last digit in any order of the scans.
    scans : int
        Number of scans with a point that was counted.
    left_out : int
        Number of points without a value.
    """

    BIN_COUNT: ClassVar[int]
    SUMMED: ClassVar[tuple[str, ...]]
    __slots__ = ("counts", "left_out", "scan_sums", "scans")

    def __init__(self, group_count: int) -> None:
        if group_count < 1:
            raise ValueError(f"group_count: {group_count}, not positive")
        self.counts: Counts = np.zeros((2, group_count, self.BIN_COUNT), np.int64)
        self.scan_sums = {name: array("d") for name in self.SUMMED}
        self.scans = 0
        self.left_out = 0

    @property
    def group_count(self) -> int:
        """G, the number of groups."""
        return int(self.counts.shape[1])

    @property
    def points(self) -> Counts:
        """Number of points of each group, (G,)."""
        points: Counts = self.counts.sum(axis=(0, 2))
        return points

    def means(self, name: str) -> Ratios:
        """Divide a sum by the number of points of each group, (G,); NaN for one without points."""
        sums = self.scan_sums[name]
        pairs = enumerate(self.points.tolist())
        return np.array(
            [math.fsum(sums[i :: self.group_count]) / n if n else np.nan for i, n in pairs]
        )

    def count(
        self,
        known: Mask,
        wrong: Mask,
        group: npt.NDArray[Any],
        bins: npt.NDArray[np.intp],
        **values: Ratios,
    ) -> Self:
        """Count the known points of a scan, all arrays (N,), and return this histogram."""
        require_points(len(known), wrong=wrong, group=group)
        wrong, group, bins = wrong[known], group[known], bins[known]
        _, groups, size = self.counts.shape
        if group.size and not 0 <= int(group.min()) <= int(group.max()) < groups:
            raise ValueError(f"group: {group.min()}…{group.max()}, not 0…{groups - 1}")
        cell = (wrong.astype(np.intp) * groups + group) * size + bins
        self.counts += np.bincount(cell, minlength=self.counts.size).reshape(self.counts.shape)
        self.scans += len(bins) > 0
        self.left_out += len(known) - len(bins)
        for name, sums in self.scan_sums.items():
            sums.extend(np.bincount(group, values[name][known], groups).tolist())
        return self

    def add(self, other: Self) -> None:
        """Add the counts of other scans."""
        if other.group_count != self.group_count:
            raise ValueError(f"{self.group_count} and {other.group_count} groups do not add")
        self.counts += other.counts
        for name, sums in self.scan_sums.items():
            sums.extend(other.scan_sums[name])
        self.scans += other.scans
        self.left_out += other.left_out

    def group(self, index: int) -> Self:
        """Return the histogram of one group."""
        sums = {name: s[index :: self.group_count] for name, s in self.scan_sums.items()}
        return self._of_one_group(self.counts[:, index : index + 1], sums)

    def total(self) -> Self:
        """Return the histogram of all groups together, as one group."""
        return self._of_one_group(self.counts.sum(axis=1, keepdims=True), self.scan_sums)

    def _of_one_group(self, counts: Counts, scan_sums: dict[str, array[float]]) -> Self:
        new = type(self)(1)
        new.counts, new.scan_sums = counts, scan_sums
        new.scans, new.left_out = self.scans, self.left_out
        return new


def require_points(points: int, **arrays: npt.NDArray[Any]) -> None:
    """Raise `ValueError` unless each array has one integer per point."""
    for name, values in arrays.items():
        if values.shape != (points,) or values.dtype.kind not in "iub":
            raise ValueError(f"{name}: {values.shape} {values.dtype}, not ({points},) integers")
