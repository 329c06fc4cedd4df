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

from salsanext_cli.errors import UsageError

Double = npt.NDArray[np.float64]

SHARE_OF_SPREAD = 0.5
"""Least distance of a chosen scan from earlier ones, as a share of what is possible for so many.
There are always enough scans for a share of 1/2 or less: each ball of that radius holds but one of
the scans that are a whole spread apart."""


@dataclass(frozen=True, slots=True)
class Choice:
    """A chosen scan."""

    scan: int  # Its position among the scans to choose from
    uncertainty: float  # Its uncertainty
    uncertainty_rank: int  # Number of its uncertainty in decreasing order, from 1
    # Distance to the nearest scan that was chosen before it, in units of the root mean square
    # distance between two scans; NaN for the first
    distance: float = math.nan
    nearest: int | None = None  # Position of that scan; None for the first


def choose_scans(
    features: npt.ArrayLike,
    uncertainty: npt.ArrayLike,
    count: int,
    labelled: Sequence[int] = (),
) -> list[Choice]:
    """Choose the scans most worth labelling, the most valuable first.

    `features` (S, F) weigh equally, by their standard deviation; `uncertainty` (S,) is at least 0;
    `labelled` scans count as chosen before all others, and are not returned.
    """
    weights = np.asarray(uncertainty, np.float64)
    points, before = standardised(features), list(labelled)
    total = min(len(before) + count, len(weights))
    order = _greedy(points, weights, total, before)
    ranks = np.empty(len(weights), np.intp)
    ranks[np.argsort(-weights, kind="stable")] = np.arange(1, len(weights) + 1)
    chosen = []
    for number, scan in enumerate(order[len(before) :], start=len(before)):
        nearest = _nearest(points, scan, order[:number])
        chosen.append(Choice(scan, float(weights[scan]), int(ranks[scan]), *nearest))
    return chosen


def require_choice(count: int, seed: int) -> None:
    """Refuse wrong settings of a choice, before any scan is read."""
    if count < 1:
        raise UsageError("--count", str(count), "at least 1")
    if seed < 0:
        raise UsageError("--seed", str(seed), "a whole number of at least 0")


def standardised(features: npt.ArrayLike) -> Double:
    """Return features (S, ≤ F) of mean 0 and equal deviations; the RMS distance of scans is 1."""
    values = np.asarray(features, np.float64)
    centred = values - values.mean(axis=0)
    deviation = np.sqrt((centred**2).sum(axis=0) / max(1, len(values) - 1))
    # What rounding leaves of a feature that is the same everywhere tells nothing.
    varies = deviation > 1e-9 * np.abs(values).max(axis=0, initial=0)
    scaled: Double = centred[:, varies] / deviation[varies]
    return scaled / math.sqrt(2 * max(1, int(varies.sum())))


def distances(points: Double, scan: int) -> Double:
    """Return the distance of every scan from one, (S,)."""
    return np.linalg.norm(points - points[scan], axis=1)


def spread(points: Double, count: int) -> float:
    """Return the least distance of a farthest-first choice; infinite for one scan."""
    apart = np.full(len(points), math.inf)
    scan, least = int(np.linalg.norm(points, axis=1).argmin()), math.inf  # Nearest to the mean
    for _ in range(count - 1):
        apart = np.minimum(apart, distances(points, scan))
        scan = int(apart.argmax())
        least = float(apart[scan])
    return least


def _greedy(points: Double, weights: Double, count: int, before: Sequence[int]) -> list[int]:
    """Choose by uncertainty times distance, among scans far enough from all that are chosen."""
    least = SHARE_OF_SPREAD * spread(points, count)
    order = list(before) or [int(weights.argmax())]
    apart = np.min([distances(points, scan) for scan in order], axis=0)
    left = np.ones(len(weights), bool)
    left[order] = False
    while len(order) < count:
        unlike = left & (apart > 0)
        # Scans equal to chosen ones come last, and differ by their uncertainty only.
        score = weights * apart if unlike.any() else weights
        # Rounding may hide the one that must be far enough.
        levels = (unlike & (apart >= least), unlike, left)
        eligible = next(level for level in levels if level.any())
        scan = int(np.where(eligible, score, -math.inf).argmax())
        order.append(scan)
        left[scan] = False
        apart = np.minimum(apart, distances(points, scan))
    return order


def _nearest(points: Double, scan: int, earlier: Sequence[int]) -> tuple[float, int | None]:
    """Return the distance of a scan to the nearest of the earlier ones, and that one."""
    if not earlier:
        return math.nan, None
    apart = np.linalg.norm(points[list(earlier)] - points[scan], axis=1)
    nearest = int(apart.argmin())
    return float(apart[nearest]), earlier[nearest]
