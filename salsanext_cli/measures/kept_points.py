# SPDX-License-Identifier: MIT
"""Points worth keeping by their uncertainty: a threshold, and what it costs and gains."""

import math
from dataclasses import dataclass

import numpy as np

from salsanext_cli.measures.histograms import Histogram, highest_of_bins

PERCENT_KEPT = 80
"""Share of the points, in percent, that the threshold keeps as nearly as it can."""
FEW_DIGITS = (1, 2, 3, 4)
"""Significant digits of a threshold that is rounded, where that keeps the same points."""
UNITS = {"entropy": " nats"}


@dataclass(frozen=True, slots=True)
class KeptPoints:
    """Points whose uncertainty is below a threshold."""

    kind: str  # The kind of uncertainty
    points: int  # Number of all points that have it
    risk_of_all: float  # Share of these that is wrong, 0…1
    # NaN where no threshold can help: no point is wrong, or no point is right, or all points have
    # values of one bin of the histogram
    threshold: float = math.nan
    # Share of the points below the threshold, and share of those that is wrong, 0…1; NaN without a
    # threshold. Both are exact
    coverage: float = math.nan
    risk: float = math.nan

    @property
    def sentence(self) -> str:
        """The same for people."""
        kind, points = self.kind, f"{self.points:,} points"
        if not self.risk_of_all:
            return f"no threshold of {kind} is needed: none of the {points} is wrong"
        if self.risk_of_all == 1:
            return f"no threshold of {kind} helps: all {points} are wrong"
        if math.isnan(self.threshold):
            return f"no threshold of {kind} helps: it is the same at all {points}"
        below = f"{kind} below {self.threshold:.4g}{UNITS.get(kind, '')}"
        # A little less than all is not all.
        kept = f"the {min(100 * self.coverage, 99.9):.3g} % of points with {below}"
        risk, of_all = _percent(self.risk), _percent(self.risk_of_all)
        if self.risk < self.risk_of_all and risk != of_all:
            return f"keep {kept}: {risk} of them are wrong instead of {of_all}"
        return f"{kind} does not find wrong points: of {kept} {risk} are wrong, of all {of_all}"


def kept_points(kind: str, histogram: Histogram) -> KeptPoints:
    """Find the threshold that keeps nearly `PERCENT_KEPT` of the points, of tied ones all or none.

    `kind`: the kind of uncertainty; `histogram`: an `uncertainty_histogram` of at least one point;
    its groups are taken together.
    """
    right, wrong = histogram.total().counts[:, 0]
    tied = right + wrong
    reached, errors = tied.cumsum(), wrong.cumsum()
    points, risk_of_all = int(reached[-1]), float(errors[-1] / reached[-1])
    held = np.flatnonzero(tied)
    if risk_of_all in (0, 1) or len(held) == 1:
        return KeptPoints(kind, points, risk_of_all)
    place = np.abs(100 * reached[held[:-1]] - PERCENT_KEPT * points).argmin()
    last, following = held[place : place + 2]
    return KeptPoints(
        kind=kind,
        points=points,
        risk_of_all=risk_of_all,
        threshold=_between(*highest_of_bins()[[last, following - 1]]),
        coverage=float(reached[last] / points),
        risk=float(errors[last] / reached[last]),
    )


def _between(highest: float, others: float) -> float:
    """Return a number of few digits above the highest value of a bin and not above those kept out.

    `others` is the highest value of the bins without points between them, or `highest` itself.
    """
    lowest_out = float(np.nextafter(np.float32(others), np.float32(np.inf)))
    middle = (highest + lowest_out) / 2
    rounded = (float(f"{middle:.{digits}g}") for digits in FEW_DIGITS)
    return next((each for each in rounded if highest < each <= lowest_out), lowest_out)


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %" if share >= 0.01 else f"{100 * share:.2g} %"
