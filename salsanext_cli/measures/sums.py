# SPDX-License-Identifier: MIT
"""Sums of numbers by group, the same to the last digit in whatever order scans are added."""

from __future__ import annotations

import math
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from salsanext_cli.measures.confusion import Counts, Ratios

FINEST = -100
"""Sums are whole multiples of 2 to this power: floats round when they are added, integers not."""


class Sums:
    """One sum per group; adding two gives the sums of both.

    Parameters
    ----------
    units : tuple of int
        The sums to start from, in units of 2 to the power `FINEST`.
    """

    __slots__ = ("units",)

    def __init__(self, units: tuple[int, ...]) -> None:
        self.units = units

    @classmethod
    def none(cls, group_count: int) -> Sums:
        """Return the sums of nothing."""
        return cls((0,) * group_count)

    def update(self, values: npt.NDArray[np.float64], group: npt.NDArray[Any]) -> Self:
        """Add the values of a scan.

        Parameters
        ----------
        values : (N,) float64
            Finite numbers.
        group : (N,) integer
            The group of each, 0…G-1.

        Returns
        -------
        Sums
            This one.
        """
        new = np.bincount(group, values, len(self.units)).tolist()
        units = (int(math.ldexp(value, -FINEST)) for value in new)
        self.units = tuple(old + unit for old, unit in zip(self.units, units, strict=True))
        return self

    def group(self, index: int) -> Sums:
        """Return the sum of one group."""
        return Sums(self.units[index : index + 1])

    def total(self) -> Sums:
        """Return the sum over all groups, as one group."""
        return Sums((sum(self.units),))

    def means(self, counts: Counts) -> Ratios:
        """Divide by the number of values in each group, (G,); NaN where there are none."""
        pairs = zip(self.units, counts.tolist(), strict=True)
        return np.array([unit / (n << -FINEST) if n else math.nan for unit, n in pairs])

    def __add__(self, other: Sums) -> Sums:
        return Sums(tuple(a + b for a, b in zip(self.units, other.units, strict=True)))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sums) and self.units == other.units

    __hash__ = None  # type: ignore[assignment]
