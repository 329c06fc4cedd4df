# SPDX-License-Identifier: MIT
"""Choice of the scans most worth labelling: uncertain ones, unlike those chosen before.

Greedy k-centre (Sener & Savarese, ICLR 2018) on a vector of features per scan, weighted by the
scan's uncertainty.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.records import Double
from salsanext_cli.core.wording import argument

SHARE_OF_SPREAD = 0.5
"""Least distance of a chosen scan from earlier ones, as a share of `spread`.

There are always enough scans for a share of at most 1/2: a ball of that radius contains only one of
the scans that are a spread apart.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """A chosen scan; NaN and None if there is no earlier one."""

    scan: int  # Its index among the scans to choose from
    uncertainty: float
    uncertainty_rank: int  # From 1, the most uncertain scan
    distance: float  # To the nearest earlier scan; 1 is the RMS distance between two scans
    nearest: int | None  # Index of that scan


def choose_scans(
    features: npt.ArrayLike, uncertainty: npt.ArrayLike, count: int, labelled: Sequence[int] = ()
) -> list[Choice]:
    """Choose the scans most worth labelling, the most valuable first.

    They are chosen by uncertainty times distance, among scans far enough from all chosen ones.

    Parameters
    ----------
    features : (S, F) numbers
        Features of the scans, which have equal weights.
    uncertainty : (S,) numbers
        Uncertainty of each scan, at least 0.
    count : int
        Largest number of scans to choose.
    labelled : sequence of int
        Indices of scans that count as chosen before all others and are not returned.

    Returns
    -------
    list of Choice
    """
    weights = np.asarray(uncertainty, np.float64)
    points = standardised(features)
    total = min(len(labelled) + count, len(weights))
    least = SHARE_OF_SPREAD * spread(points, total)
    ranks = np.empty(len(weights), np.intp)
    ranks[np.argsort(-weights, kind="stable")] = np.arange(1, len(weights) + 1)
    left = ~np.isin(np.arange(len(weights)), labelled)
    apart = np.full(len(weights), math.inf)
    nearest = np.zeros(len(weights), np.intp)
    chosen = []
    for number in range(total):
        if number < len(labelled):
            scan = labelled[number]
        else:
            unlike = left & (apart > 0)
            # Scans equal to chosen ones come last, in the order of their uncertainty.
            score = weights * apart if number and unlike.any() else weights
            # By rounding, no scan may be far enough.
            levels = (unlike & (apart >= least), unlike, left)
            eligible = next(level for level in levels if level.any())
            scan = int(np.where(eligible, score, -math.inf).argmax())
            choice = Choice(
                scan=scan,
                uncertainty=float(weights[scan]),
                uncertainty_rank=int(ranks[scan]),
                distance=float(apart[scan]) if number else math.nan,
                nearest=int(nearest[scan]) if number else None,
            )
            chosen.append(choice)
        left[scan] = False
        distance = distances(points, scan)
        nearest[distance < apart] = scan
        apart = np.minimum(apart, distance)
    return chosen


def require_choice(count: int, seed: int) -> None:
    """Raise `UsageError` for settings of a choice below their minimum."""
    if count < 1:
        raise UsageError(argument("count"), f"is {count}", "at least 1")
    if seed < 0:
        raise UsageError(argument("seed"), f"is {seed}", "at least 0")


def standardised(features: npt.ArrayLike) -> Double:
    """Return features (S, ≤ F) of mean 0 and equal deviations; the RMS distance of scans is 1."""
    values = np.asarray(features, np.float64)
    centred = values - values.mean(axis=0)
    deviation = np.sqrt((centred**2).sum(axis=0) / max(1, len(values) - 1))
    # Constant features vary only by rounding.
    varies = deviation > 1e-9 * np.abs(values).max(axis=0, initial=0)
    scaled: Double = centred[:, varies] / deviation[varies]
    return scaled / math.sqrt(2 * max(1, int(varies.sum())))


def distances(points: Double, scan: int) -> Double:
    """Return the distances (S,) of all scans from one."""
    return np.linalg.norm(points - points[scan], axis=1)


def spread(points: Double, count: int) -> float:
    """Return the least distance of a farthest-first choice; infinite for one scan."""
    apart = np.full(len(points), math.inf)
    scan = int(np.linalg.norm(points, axis=1).argmin())  # Nearest to the mean
    least = math.inf
    for _ in range(count - 1):
        apart = np.minimum(apart, distances(points, scan))
        scan = int(apart.argmax())
        least = float(apart[scan])
    return least
