# SPDX-License-Identifier: MIT
"""Parameters of the kNN refinement."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from salsanext_cli.errors import UsageError
from salsanext_cli.records import Float, Int

LARGEST_WINDOW_PX = 63
"""Largest side of the window in pixels."""


@dataclass(frozen=True, slots=True)
class KnnParameters:
    """Settings of the neighbourhood and of the vote; the defaults are the published ones.

    Attributes
    ----------
    k : int
        Number of nearest neighbours that may vote, the point's own pixel included.
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
        window, k = self.window, self.k
        possible = {
            "window": 1 <= window <= LARGEST_WINDOW_PX and window % 2 == 1,
            "k": 1 <= k <= window**2,
            "sigma": 0 < self.sigma < math.inf,
            "cutoff": self.cutoff >= 0,
        }
        expected = {
            "window": f"an odd window from 1 to {LARGEST_WINDOW_PX}",
            "k": f"1 ≤ k ≤ {window**2} neighbours in a window of {window}",
            "sigma": "a finite sigma above 0 pixels",
            "cutoff": "a cutoff ≥ 0 metres",
        }
        for name, holds in possible.items():
            if not holds:
                raise UsageError("knn", f"{name} {getattr(self, name)}", expected[name])

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
            Their factors, 1 − Gaussian.
        """
        half = self.window // 2
        dy, dx = np.mgrid[-half : half + 1, -half : half + 1]
        kept = (dx >= -((width - 1) // 2)) & (dx <= width // 2) & ((dx != 0) | (dy != 0))
        offsets = dy * (width + 2 * half) + dx
        gaussian = np.exp(-(dy**2 + dx**2) / (2 * self.sigma**2))
        weights = 1 - gaussian / gaussian.sum()
        return offsets[kept].astype(np.int32), weights[kept].astype(np.float32)
