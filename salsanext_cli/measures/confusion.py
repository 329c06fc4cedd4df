# SPDX-License-Identifier: MIT
"""Confusion matrix: counts of points by true class and by predicted class."""

from __future__ import annotations

from typing import Any, Self

import numpy as np
import numpy.typing as npt

Counts = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]
Ratios = npt.NDArray[np.float64]


class Confusion:
    """Counts of (truth, prediction) pairs; adding two gives the counts of both.

    Every point is counted, also those whose truth is ignored: they are left out when the counts
    are divided.

    `class_count`: c, the number of train ids including 0; `matrix` (C, C) int64, optional, counts
    to start from, truth × prediction; zeros if not given.
    """

    __slots__ = ("matrix",)

    def __init__(self, class_count: int, matrix: Counts | None = None) -> None:
        self.matrix: Counts = np.zeros((class_count, class_count), np.int64)
        if matrix is not None:
            self.matrix += matrix

    @property
    def class_count(self) -> int:
        """C, the number of train ids including 0."""
        return len(self.matrix)

    def update(self, truth: npt.NDArray[Any], predicted: npt.NDArray[Any]) -> Self:
        """Count the points of a scan, or the pixels of an image.

        `truth`, `predicted`: train ids, 0…C-1.
        """
        if truth.shape != predicted.shape:
            raise ValueError(f"truth {truth.shape} and predicted {predicted.shape} differ in shape")
        for name, ids in (("truth", truth), ("predicted", predicted)):
            if ids.dtype.kind not in "iu":
                raise ValueError(f"{name}: {ids.dtype}, not train ids")
            if ids.size and not 0 <= int(ids.min()) <= int(ids.max()) < self.class_count:
                raise ValueError(f"{name}: {ids.min()}…{ids.max()}, not 0…{self.class_count - 1}")
        cell = truth.ravel().astype(np.intp) * self.class_count + predicted.ravel().astype(np.intp)
        self.matrix += np.bincount(cell, minlength=self.matrix.size).reshape(self.matrix.shape)
        return self

    def counted(self, scored: Mask) -> Counts:
        """Return the matrix without the points whose truth is ignored.

        Columns of ignored classes stay: a labelled point predicted "unlabelled" is a miss.

        `scored` (C,) bool, classes that count.

        Returns (C, C) int64, truth × prediction, the rows of ignored classes 0.
        """
        return np.where(scored[:, None], self.matrix, 0)

    def __add__(self, other: Confusion) -> Confusion:
        if other.class_count != self.class_count:
            raise ValueError(f"{self.class_count} and {other.class_count} classes do not add")
        return Confusion(self.class_count, self.matrix + other.matrix)


def ratio(part: Counts, whole: Counts) -> Ratios:
    """Divide counts; NaN where there is nothing to divide by."""
    quotient: Ratios = np.full(whole.shape, np.nan)
    np.divide(part, whole, out=quotient, where=whole > 0)
    return quotient
