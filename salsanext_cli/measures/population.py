# SPDX-License-Identifier: MIT
"""Comparison of scans with those that a guarantee was obtained on, without their true labels.

A guarantee holds for scans that are exchangeable with those it was obtained on. Labels are not
needed to see that scans are not: the shares of the predicted classes and the mean uncertainty of
both groups would differ less. Units of one drive after another are alike, so they are not
exchangeable and differ more. A permutation test with the largest standardised difference decides
(Westfall and Young 1993: the maximum over the traits needs no correction for their number).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from salsanext_cli.errors import percentage
from salsanext_cli.measures.scores import Counts
from salsanext_cli.network.card import LabelTraits
from salsanext_cli.records import Double, Float

PERMUTATIONS = 999
LIKELY = 0.01
"""Largest probability of a difference by chance that is reported. One of 24 simulated drives and
12 others is 0.6; of 24 simulated drives and ten excerpts of SemanticKITTI 0.007."""
EDGE = 1e-4  # Least distance of an uncertainty from 0 and 1, whose logits are infinite
DIGITS = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class PopulationDifference:
    """Trait in which two groups of scans differ most."""

    trait: str  # Name of a class, or "uncertainty"
    before: float  # Mean of the group that the guarantee was obtained on, 0…1
    now: float  # Mean of the other group, 0…1
    chance: float  # Probability of so large a difference between exchangeable groups

    def __str__(self) -> str:
        """State both means in per cent."""
        subject = "mean uncertainty" if self.trait == "uncertainty" else f"share of {self.trait}"
        return f"{subject} {percentage(self.now)} instead of {percentage(self.before)}"


def label_traits(unit: str, class_points: Counts, uncertainty: Float) -> LabelTraits:
    """Return the traits of the labels of a scan.

    Parameters
    ----------
    unit : str
        Name of the scan or drive.
    class_points : ndarray of int (C,)
        Number of points by predicted train id; those of class 0 do not count.
    uncertainty : ndarray of float32 (N,)
        Uncertainty that the threshold limits, 0…1, NaN for points without a pixel.

    Returns
    -------
    LabelTraits
    """
    shares = class_points[1:] / max(class_points[1:].sum(), 1)
    known = uncertainty[~np.isnan(uncertainty)]
    mean = float(known.mean(dtype=np.float64)) if known.size else 1.0
    return _rounded(unit, mean, shares)


def of_units(traits: Sequence[LabelTraits], units: Sequence[str]) -> tuple[LabelTraits, ...]:
    """Return the mean traits of each unit, such as a drive, in the order of their names.

    Parameters
    ----------
    traits : sequence of LabelTraits
        Traits of scans.
    units : sequence of str
        Name of the unit of each scan.

    Returns
    -------
    tuple of LabelTraits
    """
    means = []
    for unit in sorted({*units}):
        members = [scan for scan, name in zip(traits, units, strict=True) if name == unit]
        uncertainty, *shares = _plain(members).mean(axis=0)
        means.append(_rounded(unit, uncertainty, np.array(shares)))
    return tuple(means)


def _rounded(unit: str, uncertainty: float, shares: Double) -> LabelTraits:
    """Return traits with few digits, since a file of weights contains those of every unit."""
    return LabelTraits(
        unit=unit,
        uncertainty=round(float(uncertainty), DIGITS),
        class_shares=tuple(round(float(share), DIGITS) for share in shares),
    )


def population_difference(
    before: Sequence[LabelTraits], now: Sequence[LabelTraits], names: Sequence[str]
) -> PopulationDifference | None:
    """Return the largest difference between two groups of scans, None if chance may explain it.

    Parameters
    ----------
    before, now : sequence of LabelTraits
        Scans or drives that a guarantee was obtained on, and other ones. All have the same classes.
    names : sequence of str
        Names of the classes from train id 1 on, (C − 1,).

    Returns
    -------
    PopulationDifference or None
    """
    if not before or not now:
        return None
    traits = _scaled([*before, *now])
    spread = traits.std(axis=0)
    count = len(before)
    observed = _differences(traits[:count], traits[count:], spread)
    rng = np.random.default_rng(0)
    as_large = 1
    for _ in range(PERMUTATIONS):
        drawn = rng.permutation(traits)
        differences = _differences(drawn[:count], drawn[count:], spread)
        as_large += int(differences.max() >= observed.max() - 1e-9)
    # Of all divisions, the observed one is at least as extreme; draws may miss that by chance.
    chance = max(as_large / (PERMUTATIONS + 1), 1 / math.comb(len(traits), count))
    if chance > LIKELY:
        return None
    largest = int(observed.argmax())
    means = [_plain(group).mean(axis=0)[largest] for group in (before, now)]
    return PopulationDifference(
        trait=("uncertainty", *names)[largest],
        before=float(means[0]),
        now=float(means[1]),
        chance=chance,
    )


def _plain(traits: Sequence[LabelTraits]) -> Double:
    """Return uncertainty and shares of the classes of each unit, (U, C) float64."""
    return np.array([(unit.uncertainty, *unit.class_shares) for unit in traits], np.float64)


def _scaled(traits: Sequence[LabelTraits]) -> Double:
    """Return traits (U, C) on scales whose spread depends less on their size."""
    values = _plain(traits)
    uncertainty = values[:, 0].clip(EDGE, 1 - EDGE)
    return np.column_stack([np.log(uncertainty / (1 - uncertainty)), np.sqrt(values[:, 1:])])


def _differences(before: Double, now: Double, spread: Double) -> Double:
    """Return the absolute differences of the means of two groups (U, C) and (V, C), (C,)."""
    gaps = np.abs(before.mean(axis=0) - now.mean(axis=0))
    return np.divide(gaps, spread, out=np.zeros_like(gaps), where=spread > 1e-9)
