# SPDX-License-Identifier: MIT
"""Comparison of scans with those that a guarantee was obtained on, without their true labels.

A guarantee holds for scans that are exchangeable with those it was obtained on. Labels are not
needed to see that scans are not: the shares of the predicted classes, the mean uncertainty and
measures of the scans of both groups would differ less. Units of one drive after another are alike,
so they are not exchangeable and differ more. A permutation test with the largest standardised
difference decides (Westfall and Young 1993: the maximum over the traits needs no correction for
their number). So few units that every division of them is likely show no difference in that way;
they are compared with the prediction interval of a normal distribution instead.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from salsanext_cli.core.geometry.scan_measures import MEASURES, compared_measures
from salsanext_cli.core.measures.scores import Counts
from salsanext_cli.core.network.unit_traits import UnitTraits
from salsanext_cli.core.records import Double, Float
from salsanext_cli.core.texts import percentage

PERMUTATIONS = 999
LIKELY = 0.01
"""Largest probability of a difference by chance that is reported of enough units.

That of 24 simulated drives and 12 others is 0.4; of 24 simulated drives and four or five of
SemanticKITTI 0.001."""
LIKELY_OF_FEW = 0.001
"""Largest probability of such a difference between few units, over all traits together.

Traits of few units are hardly normally distributed. Of 4 000 choices of 24 simulated drives and
another one, 12 were below. The limit is 5.2 times the usual deviation; PandaSet had 6.9 or more,
16 % of a circle 35, SemanticKITTI up to 2.4."""
MOST_WITH_CODE = 0.5  # Share of the units with a new code above which it tells scans apart
EDGE = 1e-4  # Least distance of an uncertainty from 0 and 1, whose logits are infinite
LEAST_UNCERTAINTY = 0.3  # Least usual deviation of the logit of an uncertainty
LEAST_SHARE = 0.05  # Least usual deviation of the root of a share
DIGITS = 4
STEPS = 10_001  # Of the integral of a density


@dataclass(frozen=True, slots=True, kw_only=True)
class PopulationDifference:
    """Trait in which two groups of scans differ most."""

    trait: str  # Name of a class or of one of `MEASURES`, or "uncertainty"
    before: float  # Mean of the group that the guarantee was obtained on
    now: float  # Mean of the other group
    chance: float  # Probability of so large a difference between exchangeable groups

    def __str__(self) -> str:
        """State both means."""
        measure = next((measure for measure in MEASURES if measure.name == self.trait), None)
        if measure:
            return f"{self.trait} {measure.text(self.now)} instead of {measure.text(self.before)}"
        subject = "mean uncertainty" if self.trait == "uncertainty" else f"share of {self.trait}"
        return f"{subject} {percentage(self.now)} instead of {percentage(self.before)}"


def unit_traits(
    unit: str,
    class_points: Counts,
    uncertainty: Float,
    measures: Sequence[float] = (),
    codes: Sequence[str] = (),
) -> UnitTraits:
    """Return the traits of a scan and its labels.

    Parameters
    ----------
    unit : str
        Name of the scan or drive.
    class_points : ndarray of int (C,)
        Number of points by predicted train id; those of class 0 do not count.
    uncertainty : ndarray of float32 (N,)
        Uncertainty that the threshold limits, 0…1, NaN for points without a pixel.
    measures : sequence of float
        As of `measures_of`.
    codes : sequence of str
        Codes of the warnings about the scan.

    Returns
    -------
    UnitTraits
    """
    shares = class_points[1:] / max(class_points[1:].sum(), 1)
    values = uncertainty[~np.isnan(uncertainty)]
    mean = float(values.mean(dtype=np.float64)) if values.size else 1.0
    return UnitTraits(
        unit=unit,
        uncertainty=round(mean, DIGITS),
        class_shares=_rounded(shares),
        measures=tuple(measures),
        codes=tuple(sorted({*codes})),
    )


def traits_of_units(traits: Sequence[UnitTraits], units: Sequence[str]) -> tuple[UnitTraits, ...]:
    """Return the mean traits of each unit, such as a drive, in the order of their names.

    A unit has the codes that most of its scans have.

    Parameters
    ----------
    traits : sequence of UnitTraits
        Traits of scans.
    units : sequence of str
        Name of the unit of each scan.

    Returns
    -------
    tuple of UnitTraits
    """
    means = []
    for unit in sorted({*units}):
        members = [scan for scan, name in zip(traits, units, strict=True) if name == unit]
        measures = np.array([scan.measures for scan in members]).mean(axis=0)
        shares = np.array([scan.class_shares for scan in members]).mean(axis=0)
        uncertainty = float(np.mean([scan.uncertainty for scan in members]))
        means.append(
            UnitTraits(
                unit=unit,
                uncertainty=round(uncertainty, DIGITS),
                class_shares=_rounded(shares),
                measures=_rounded(measures),
                codes=_codes_of_most(members),
            )
        )
    return tuple(means)


def _rounded(values: Double) -> tuple[float, ...]:
    """Return few digits, since a file of weights contains the traits of every unit."""
    return tuple(round(float(value), DIGITS) for value in values)


def _codes_of_most(units: Sequence[UnitTraits]) -> tuple[str, ...]:
    """Return the codes that most of the units have."""
    codes = sorted({code for unit in units for code in unit.codes})
    return tuple(
        code
        for code in codes
        if sum(code in unit.codes for unit in units) > MOST_WITH_CODE * len(units)
    )


def new_codes(before: Sequence[UnitTraits], now: Sequence[UnitTraits]) -> tuple[str, ...]:
    """Return the codes of warnings that most of the new units and none of the earlier ones have."""
    earlier = {code for unit in before for code in unit.codes}
    return tuple(code for code in _codes_of_most(now) if code not in earlier)


def are_comparable(before: int, now: int) -> bool:
    """Return whether a permutation test of two groups of so many units can show a difference."""
    # The number of divisions may be too large for a float, but it can be compared with one.
    return before > 0 and now > 0 and math.comb(before + now, now) >= 1 / LIKELY


def population_difference(
    before: Sequence[UnitTraits], now: Sequence[UnitTraits], names: Sequence[str]
) -> PopulationDifference | None:
    """Return the largest difference between two groups of scans, None if chance may explain it.

    Parameters
    ----------
    before : sequence of UnitTraits
        Scans or drives that a guarantee was obtained on.
    now : sequence of UnitTraits
        Other scans or drives, with the same classes. Measures are compared if all have them.
    names : sequence of str
        Names of the classes from train id 1 on, (C − 1,).

    Returns
    -------
    PopulationDifference or None
    """
    if not before or not now:
        return None
    all_units = [*before, *now]
    if not have_measures(all_units):
        all_units = _without_measures(all_units)
    traits = _compared(all_units)
    count = len(before)
    if are_comparable(count, len(now)):
        largest, chance = _by_permutation(traits, count)
        likely = LIKELY
    elif count > 1:
        least = [LEAST_UNCERTAINTY] + [LEAST_SHARE] * len(names)
        least += [measure.least_spread for measure in MEASURES]
        largest, chance = _by_prediction(traits, count, np.array(least[: traits.shape[1]]))
        likely = LIKELY_OF_FEW
    else:
        return None
    if chance > likely:
        return None
    trait_names = ["uncertainty", *names] + [measure.name for measure in MEASURES]
    values = _plain(all_units)[:, largest]
    return PopulationDifference(
        trait=trait_names[largest],
        before=float(values[:count].mean()),
        now=float(values[count:].mean()),
        chance=chance,
    )


def _by_permutation(traits: Double, count: int) -> tuple[int, float]:
    """Return the trait (U, T) that differs most after `count` units, and the chance of that."""
    observed = _differences(traits[:count].sum(axis=0)[None], count, traits)[0]
    rng = np.random.default_rng(0)
    orders = (rng.permutation(len(traits)) for _ in range(PERMUTATIONS))
    sums = np.array([traits[order[:count]].sum(axis=0) for order in orders])
    largest = _differences(sums, count, traits).max(axis=1)
    as_large = 1 + int(np.count_nonzero(largest >= observed.max() - 1e-9))
    # Of all divisions, the observed one is at least as extreme; draws may miss that by chance.
    chance = max(as_large / (PERMUTATIONS + 1), 1 / math.comb(len(traits), count))
    return int(observed.argmax()), chance


def _by_prediction(traits: Double, count: int, least: Double) -> tuple[int, float]:
    """Return the same by the deviation from `count` units as if these were drawn from a normal.

    `least` (T,): least usual deviations. The new units count as one.
    """
    before = traits[:count]
    now = traits[count:].mean(axis=0)
    spread = np.maximum(before.std(axis=0, ddof=1), least)
    deviations = np.abs(now - before.mean(axis=0)) / (spread * math.sqrt(1 + 1 / count))
    largest = int(deviations.argmax())
    chance = 2 * upper_tail(float(deviations[largest]), count - 1)
    return largest, min(chance * len(deviations), 1.0)


def upper_tail(value: float, degrees: int) -> float:
    """Return the probability that a variable of Student's distribution exceeds a value.

    With the value as tan(angle) √degrees, its density is cos(angle)^(degrees − 1).
    """
    edge = math.atan(value / math.sqrt(degrees))
    return _integral(edge, degrees) / _integral(-math.pi / 2, degrees)


def _integral(edge: float, degrees: int) -> float:
    """Return the integral of cos(angle)^(degrees − 1) from an edge to π/2 by trapezoids."""
    density = np.cos(np.linspace(edge, math.pi / 2, STEPS)) ** (degrees - 1)
    step = (math.pi / 2 - edge) / (STEPS - 1)
    return float(step * (density.sum() - (density[0] + density[-1]) / 2))


def _plain(traits: Sequence[UnitTraits]) -> Double:
    """Return uncertainty, shares of the classes and measures of each unit, (U, T) float64."""
    rows = [(unit.uncertainty, *unit.class_shares, *unit.measures) for unit in traits]
    return np.array(rows, np.float64)


def _compared(traits: Sequence[UnitTraits]) -> Double:
    """Return traits (U, T) on scales whose spread depends less on their size."""
    uncertainty = np.array([unit.uncertainty for unit in traits]).clip(EDGE, 1 - EDGE)
    shares = np.array([unit.class_shares for unit in traits], np.float64)
    columns = [np.log(uncertainty / (1 - uncertainty))[:, None], np.sqrt(shares)]
    if traits[0].measures:
        columns.append(compared_measures(np.array([unit.measures for unit in traits])))
    return np.hstack(columns)


def have_measures(traits: Sequence[UnitTraits]) -> bool:
    """Return whether all units have the measures of this version."""
    return all(len(unit.measures) == len(MEASURES) for unit in traits)


def _without_measures(traits: Sequence[UnitTraits]) -> list[UnitTraits]:
    return [replace(unit, measures=()) for unit in traits]


def _differences(sums: Double, count: int, traits: Double) -> Double:
    """Return how much the means of a group of units differ from those of the others.

    Parameters
    ----------
    sums : (P, T) float64
        Sums of the traits of such groups.
    count : int
        Number of units of a group.
    traits : (U, T) float64
        Traits of all units.

    Returns
    -------
    (P, T) float64
        Absolute differences, relative to the deviation of the trait; 0 for a trait without one.
    """
    spread = traits.std(axis=0)
    means = sums / count
    means_of_others = (traits.sum(axis=0) - sums) / (len(traits) - count)
    gaps = np.abs(means - means_of_others)
    return np.divide(gaps, spread, out=np.zeros_like(gaps), where=spread > 1e-9)
