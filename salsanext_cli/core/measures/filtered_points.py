# SPDX-License-Identifier: MIT
"""Number of points that a filter left and dropped."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class FilteredPoints:
    """Number of points of some scans, and of those that a filter left."""

    points: int = 0
    remaining: int = 0
    # Number of remaining points without a label because `predict --reject` rejected it
    rejected: int = 0
    without_error: int = 0  # Number of points dropped because they have no probability of error

    def __add__(self, other: FilteredPoints) -> FilteredPoints:
        """Return the numbers of the scans of both."""
        return FilteredPoints(
            points=self.points + other.points,
            remaining=self.remaining + other.remaining,
            rejected=self.rejected + other.rejected,
            without_error=self.without_error + other.without_error,
        )
