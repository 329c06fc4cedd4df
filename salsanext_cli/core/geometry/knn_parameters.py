# SPDX-License-Identifier: MIT
"""Settings of the kNN refinement; this module imports nothing heavy."""

import math
from dataclasses import dataclass

from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.wording import argument

MAX_WINDOW_PX = 63  # Largest side of the window, in pixels


@dataclass(frozen=True, slots=True)
class KnnParameters:
    """Settings of the kNN refinement; the defaults are those of RangeNet++.

    Attributes
    ----------
    k : int
        Number of neighbours that vote; the pixel of the point itself is one of them.
    window : int
        Side of the window of neighbours, in pixels; odd.
    sigma : float
        Standard deviation of the Gaussian weights, in pixels.
    cutoff : float
        Maximum difference in range between a point and a neighbour, in metres.
    """

    k: int = 5
    window: int = 5
    sigma: float = 1.0
    cutoff: float = 1.0

    def __post_init__(self) -> None:
        window = self.window
        most = self.window**2
        is_odd = 1 <= window <= MAX_WINDOW_PX and window % 2 == 1
        conditions = (
            ("window", is_odd, f"an odd number from 1 to {MAX_WINDOW_PX}"),
            ("k", 1 <= self.k <= most, f"1 to {most} neighbours in a window of {window} pixels"),
            ("sigma", 0 < self.sigma < math.inf, "a finite number above 0"),
            ("cutoff", self.cutoff >= 0, "0 or more metres"),
        )
        for name, holds, expected in conditions:
            if not holds:
                subject = argument(f"knn.{name}")
                raise UsageError(subject, f"the value is {getattr(self, name)}", expected)
