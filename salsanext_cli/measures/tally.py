# SPDX-License-Identifier: MIT
"""Right and wrong points by group and by bin: counts whose size does not grow with the scans."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from salsanext_cli.measures.confusion import Counts
from salsanext_cli.measures.sums import Sums

State = tuple[tuple[int, ...], npt.NDArray[Any], npt.NDArray[Any], dict[str, Sums], int, int]


class Tally(ABC):
    """Counts by right or wrong, group and bin; adding two gives the counts of both.

    Parameters
    ----------
    group_count, bin_count : int
        G and B. Groups are classes, rings of distance, or just one.
    sums : dict of str to Sums
        What else is added up.

    Attributes
    ----------
    counts : (2, G, B) int64
        Number of points; those that are right first, then those that are wrong.
    sums : dict of str to Sums
        By name.
    scans : int
        Number of scans with a point that was counted.
    left_out : int
        Number of points without a value.
    """

    __slots__ = ("counts", "left_out", "scans", "sums")

    def __init__(self, group_count: int, bin_count: int, sums: dict[str, Sums]) -> None:
        if group_count < 1:
            raise ValueError(f"group_count: {group_count}, not positive")
        self.counts: Counts = np.zeros((2, group_count, bin_count), np.int64)
        self.sums = sums
        self.scans = 0
        self.left_out = 0

    @classmethod
    @abstractmethod
    def none(cls, group_count: int) -> Self:
        """Return the counts of nothing in G groups."""

    @property
    def group_count(self) -> int:
        """G, the number of groups."""
        return int(self.counts.shape[1])

    @property
    def points(self) -> Counts:
        """Number of points of each group, (G,)."""
        points: Counts = self.counts.sum(axis=(0, 2))
        return points

    def count(
        self, wrong: npt.NDArray[np.bool_], group: npt.NDArray[Any], bins: npt.NDArray[np.intp]
    ) -> Counts:
        """Count the points of a scan, all arrays (N,), and return its own counts (2, G, B)."""
        _, groups, size = self.counts.shape
        if group.size and not 0 <= int(group.min()) <= int(group.max()) < groups:
            raise ValueError(f"group: {group.min()}…{group.max()}, not 0…{groups - 1}")
        cell = (wrong.astype(np.intp) * groups + group) * size + bins
        counted = np.bincount(cell, minlength=self.counts.size).reshape(self.counts.shape)
        self.counts += counted
        self.scans += len(bins) > 0
        return counted

    def group(self, index: int) -> Self:
        """Return the counts of one group."""
        return self._of(
            self.counts[:, index : index + 1], {k: s.group(index) for k, s in self.sums.items()}
        )

    def total(self) -> Self:
        """Return the counts of all groups together, as one group."""
        sums = {name: s.total() for name, s in self.sums.items()}
        return self._of(self.counts.sum(axis=1, keepdims=True), sums)

    def _of(self, counts: Counts, sums: dict[str, Sums]) -> Self:
        new = type(self).none(counts.shape[1])
        new.counts, new.sums, new.scans, new.left_out = counts, sums, self.scans, self.left_out
        return new

    def __add__(self, other: Self) -> Self:
        if type(other) is not type(self):
            return NotImplemented
        if other.group_count != self.group_count:
            raise ValueError(f"{self.group_count} and {other.group_count} groups do not add")
        new = self._of(
            self.counts + other.counts, {k: s + other.sums[k] for k, s in self.sums.items()}
        )
        new.scans += other.scans
        new.left_out += other.left_out
        return new

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, Tally)
            and np.array_equal(self.counts, other.counts)
            and (self.sums, self.scans, self.left_out) == (other.sums, other.scans, other.left_out)
        )

    __hash__ = None  # type: ignore[assignment]

    # Most counts are 0: passed between processes without them, a scan's are small.

    def __getstate__(self) -> State:
        places = np.flatnonzero(self.counts)
        values = self.counts.ravel()[places]
        narrow = np.min_scalar_type(values.max(initial=0))
        where = places.astype(np.min_scalar_type(self.counts.size))
        return self.counts.shape, where, values.astype(narrow), self.sums, self.scans, self.left_out

    def __setstate__(self, state: State) -> None:
        shape, places, values, self.sums, self.scans, self.left_out = state
        self.counts = np.zeros(shape, np.int64)
        self.counts.ravel()[places] = values


def require_points(points: int, **arrays: npt.NDArray[Any]) -> None:
    """Raise `ValueError` unless each array has one integer per point."""
    for name, values in arrays.items():
        if values.shape != (points,) or values.dtype.kind not in "iub":
            raise ValueError(f"{name}: {values.shape} {values.dtype}, not ({points},) integers")
