# SPDX-License-Identifier: MIT
"""Parameters of the kNN refinement."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from salsanext_cli.errors import UsageError
from salsanext_cli.records import Float, Int

LARGEST_WINDOW = 63
"""Pixels; beyond them nothing is a neighbour."""


@dataclass(frozen=True, slots=True)
class KnnParameters:
    """Settings of the neighbourhood and of the vote; the defaults are the published ones.

    Attributes
    ----------
    k : int
        How many nearest neighbours may vote, the point's own pixel included.
    window : int
        Odd side of the window in pixels.
    sigma : float
        Standard deviation of the Gaussian in pixels.
    cutoff : float
        Maximum range difference of a neighbour, in metres.
    """

    k: int = 5
    window: int = 5
    sigma: float = 1.0
    cutoff: float = 1.0

    def __post_init__(self) -> None:
        self._require(
            1 <= self.window <= LARGEST_WINDOW and self.window % 2 == 1,
            f"window {self.window}",
            f"an odd window from 1 to {LARGEST_WINDOW}",
        )
        self._require(
            1 <= self.k <= self.window**2,
            f"k {self.k}",
            f"1 ≤ k ≤ {self.window**2} neighbours in a window of {self.window}",
        )
        self._require(
            0 < self.sigma < math.inf, f"sigma {self.sigma}", "a finite sigma above 0 pixels"
        )
        self._require(self.cutoff >= 0, f"cutoff {self.cutoff}", "a cutoff ≥ 0 metres")

    def _require(self, holds: bool, found: str, expected: str) -> None:
        if not holds:
            raise UsageError("knn", found, expected)

    def candidates(self, width: int) -> tuple[Int, Float]:
        """Return the offsets of a point's candidates and the factors of their distances.

        Parameters
        ----------
        width : int
            W of the range image. If it is narrower than the window, no pixel comes round twice.

        Returns
        -------
        offsets : (M,) int32
            Flat offsets from the point's pixel, itself left out, in an image that is framed by
            ``window // 2`` pixels on each side.
        weights : (M,) float32
            Their factors, 1 − Gaussian of the offset.
        """
        half = self.window // 2
        dy, dx = np.mgrid[-half : half + 1, -half : half + 1]
        gaussian = np.exp(-(dy**2 + dx**2) / (2 * self.sigma**2))
        weights = np.asarray(1 - gaussian / gaussian.sum(), np.float32)
        kept = (dx >= -((width - 1) // 2)) & (dx <= width // 2) & ((dx != 0) | (dy != 0))
        offsets = dy * (width + 2 * half) + dx
        return offsets[kept].astype(np.int32), weights[kept]
