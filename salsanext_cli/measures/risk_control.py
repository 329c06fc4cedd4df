# SPDX-License-Identifier: MIT
"""Threshold of an uncertainty chosen from labelled scans, with a promise about a new scan.

The loss of a scan at a threshold is the share of all its scored points that are kept and wrong; it
rises with the threshold. Scans, or drives where there are enough, but not points, are taken as
exchangeable: those at hand and a new one come in any order with the same chance. The loss of a
drive is the mean of its scans. Arrays of losses are (n, T): scans or drives by rising threshold.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.errors import counted, first_few
from salsanext_cli.measures.scores import Counts, Ratios, scored_rows
from salsanext_cli.network.card import RiskThreshold

PEOPLE = ("person", "bicyclist", "motorcyclist", "person-or-cycle")
"""Classes whose points are of people."""
KEEPS_NONE = -1.0  # Threshold of a class of which no label is kept
RISK_BOUND_EXCEEDED = (
    "more is kept and wrong than was promised: by chance, if these scans are few, else because "
    "their place, sensor or weather is another than that of the scans that the threshold was "
    "chosen on; choose it with `salsanext tune risk` on labelled scans like these"
)


def means_of_units(losses: Ratios, units: npt.NDArray[Any]) -> Ratios:
    """Return the mean of each unit, as a drive of several scans, in sorted order: (n, …) to (U, …).

    `units` (n,): what names the unit of each scan.
    """
    return np.stack([losses[units == unit].mean(axis=0) for unit in np.unique(units)])


def held_thresholds(
    losses: Ratios, at_most: float, confidence: float | None = None, scans: int | None = None
) -> int:
    """Return how many of the thresholds hold a level, `at_most`.

    Without a confidence they hold the expected loss of a new scan, since
    (Σ losses + 1) / (n + 1) ≤ level: conformal risk control (Angelopoulos et al. 2022, arXiv
    2208.02814, eq. 4) of a loss of at most 1. With one they hold the loss of most scans: with this
    confidence, over the choice of the n, at most a share 1 − confidence of all scans loses more.
    `scans`: the number n, if another than that of the losses.
    """
    n = scans or len(losses)
    if confidence is None:
        return int(((n * losses.mean(axis=0) + 1) / (n + 1) <= at_most).sum())
    return int(((losses > at_most).sum(axis=0) <= allowed_scans(n, confidence)).sum())


def allowed_scans(scans: int, confidence: float) -> int:
    """Return how many of n scans may be bad for 1 − confidence to bound their share; −1: too few.

    The largest number for which the bound of Clopper and Pearson (1934) is low enough.
    """
    bad = 0
    while binomial(bad, scans, 1 - confidence) <= 1 - confidence:
        bad += 1
    return bad - 1


def binomial(most: int, count: int, chance: float) -> float:
    """Return the probability of at most so many of `count` events of a chance above 0, up to 1."""
    if most >= count or chance >= 1:
        return float(most >= count)
    logs = (
        math.lgamma(count + 1)
        - math.lgamma(k + 1)
        - math.lgamma(count - k + 1)
        + k * math.log(chance)
        + (count - k) * math.log1p(-chance)
        for k in range(most + 1)
    )
    return math.fsum(map(math.exp, logs))


def needed_scans(at_most: float, confidence: float | None) -> int:
    """Return the least number of scans for which a threshold can hold a level."""
    if confidence is None:
        # Rounded, as 1 / 0.05 - 1 is more than 19 by the last digit.
        return math.ceil(round(1 / at_most - 1, 9))
    return math.ceil(round(math.log(1 - confidence) / math.log(confidence), 9))


def enough_drives(drives: int, at_most: float, confidence: float | None) -> bool:
    """Say whether the drive, and not the scan, is the unit of a promise.

    On the mean twice the least number: with fewer, more than half of the level is set aside for the
    new drive, and few points are kept.
    """
    return drives >= needed_scans(at_most, confidence) * (2 if confidence is None else 1)


@dataclass(frozen=True, slots=True)
class KeptLabels:
    """Coverage and risk of labels of which some were rejected; points are those scored."""

    points: int  # Number of points
    kept: int  # Of them, those with a label, and of these, wrong ones
    wrong: int
    people: int  # Number of points of people, and of them, kept with a label of something else
    missed_people: int
    # Kept points and wrong ones of them, by predicted class, those of people first
    classes: dict[str, tuple[int, int]]
    # Name, points, kept and wrong ones, of the scan with the largest share that is kept and wrong
    worst: tuple[str, int, int, int]

    @classmethod
    def of_confusion(
        cls, confusion: Counts, space: LabelSpace, scans: Mapping[str, tuple[int, int, int]]
    ) -> Self:
        """Count the points whose predicted class is not 0; `scans`: as `worst`, by name."""
        matrix = scored_rows(confusion, space)
        kept, right = matrix[:, 1:].sum(axis=0), matrix.diagonal()[1:]
        of_classes = zip(space.names[1:], kept.tolist(), (kept - right).tolist(), strict=True)
        in_order = sorted(of_classes, key=lambda each: each[0] not in PEOPLE)
        people = np.isin(space.names, PEOPLE)
        worst = max(scans, key=lambda name: scans[name][2] / max(scans[name][0], 1))
        return cls(
            points=int(matrix.sum()),
            kept=int(kept.sum()),
            wrong=int((kept - right).sum()),
            people=int(matrix[people].sum()),
            missed_people=int(matrix[people][:, 1:][:, ~people[1:]].sum()),
            classes={n: (k, w) for n, k, w in in_order if k},
            worst=(worst, *scans[worst]),
        )

    @property
    def coverage(self) -> float:
        """Share of the points that is kept, 0…1."""
        return self.kept / max(self.points, 1)

    @property
    def risk(self) -> float:
        """Share of the kept points that is wrong, 0…1."""
        return self.wrong / max(self.kept, 1)

    @property
    def sentences(self) -> Iterator[str]:
        """The same for people, without the classes."""
        text = f"kept: {self.coverage:.1%} of {self.points:,} points, of which {self.risk:.1%} are"
        yield f"{text} wrong ({self.wrong / max(self.points, 1):.1%} of all)"
        name, in_worst, kept, errors = self.worst
        loss, risk = errors / max(in_worst, 1), errors / max(kept, 1)
        of_kept = f"{risk:.1%} of the {kept:,} kept"
        yield f"worst scan: {name}, {loss:.1%} of its points are kept and wrong, {of_kept}"
        if self.people:
            missed = f"{self.missed_people:,} of {self.people:,} points of people"
            yield f"missed people: {missed} are kept with a label of something else"


@dataclass(frozen=True, slots=True)
class RiskBoundCheck:
    """Promise about scans or drives beside the losses found, shares of their scored points."""

    at_most: float
    confidence: float | None  # None where the mean over them is at most that
    unit: str  # "scan" or "drive"
    units: int  # Number of scans or drives, and of those of them that lose more
    above: int
    mean: float  # Mean loss, and the largest
    worst: float

    @classmethod
    def of_scans(
        cls, promised: RiskThreshold, scans: Mapping[str, tuple[int, int, int]]
    ) -> Self | None:
        """Compare with points, kept and wrong ones of scans, by name; None without any points."""
        judged = {name: wrong / points for name, (points, _, wrong) in scans.items() if points}
        if not judged:
            return None
        losses, unit = np.array([*judged.values()]), promised.unit
        if unit == "drive":
            drives = np.array([name.rpartition("/")[0] for name in judged])
            losses = means_of_units(losses, drives)
        above = int((losses > promised.at_most).sum())
        found = len(losses), above, float(losses.mean()), float(losses.max())
        return cls(promised.at_most, promised.confidence, unit, *found)

    @property
    def is_exceeded(self) -> bool:
        """Say whether more was found than promised."""
        if self.confidence is None:
            return self.mean > self.at_most
        return self.above / self.units > round(1 - self.confidence, 9)

    @property
    def sentence(self) -> str:
        """The same for people."""
        level, worst = f"{100 * self.at_most:.3g} %", f"{100 * self.worst:.1f} % in the worst"
        judged = counted(self.units, self.unit)
        mean = f"{100 * self.mean:.1f} % on the mean of {judged}"
        if self.confidence is None:
            lost = f"at most {level} of the points of known classes of a new {self.unit}"
            return f"promised: {lost} kept and wrong, on the mean; found: {mean}, {worst}"
        sure, rest = f"{100 * self.confidence:.3g} %", f"{100 - 100 * self.confidence:.3g} %"
        found = f"{self.above} of {judged}"
        return (
            f"promised with {sure} confidence: at most {rest} of {self.unit}s with more than "
            f"{level} of their points of known classes kept and wrong; found: {found}, {worst}"
        )


def promise(risk: RiskThreshold) -> str:
    """Say what the threshold of weights holds for, of the `risk` in their card."""
    level, scans = f"{100 * risk.at_most:.3g} %", counted(risk.scans, "scan")
    kept = f"{risk.kind} up to {risk.threshold:.4g} kept"
    chosen, unit = f"({scans} of {first_few(risk.sequences)})", risk.unit
    like = f"of the drives that it was chosen on {chosen}, not of others"
    if unit == "drive":
        like = f"like those that it was chosen on {chosen}"
    classes = [name for name, above in risk.classes.items() if above > KEEPS_NONE]
    alike = f"; the same of the points labelled as each of {first_few(classes)}" if classes else ""
    if risk.confidence is None:
        expected = f"{level} of the points of known classes are expected to be kept and wrong"
        return f"{kept}: of another {unit} {like}, at most {expected}{alike}"
    sure = f"{100 * risk.confidence:.3g} %"
    rest = f"{100 - 100 * risk.confidence:.3g} %"
    more = f"more than {level} of their points of known classes kept and wrong"
    return f"{kept}: with {sure} confidence, at most {rest} of {unit}s {like} have {more}{alike}"
