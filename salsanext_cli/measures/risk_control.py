# SPDX-License-Identifier: MIT
"""Threshold of an uncertainty chosen from labelled scans, with a promise about a new scan.

The loss of a scan at a threshold is the share of all its scored points that are kept and wrong; it
rises with the threshold. Scans, not points, are taken as exchangeable: those at hand and a new one
come in any order with the same chance. Arrays of losses are (n, T): scans by rising threshold.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.errors import counted, first_few
from salsanext_cli.measures.scores import Confusion, Ratios

PEOPLE = ("person", "bicyclist", "motorcyclist", "person-or-cycle")
"""Classes whose points are of people."""


def held_thresholds(
    losses: Ratios, at_most: float, confidence: float | None = None, scans: int | None = None
) -> int:
    """Return how many of the thresholds hold a level, `at_most`.

    Without a confidence they hold the expected loss of a new scan, since
    (Σ losses + 1) / (n + 1) ≤ level: conformal risk control (Angelopoulos et al. 2022, arXiv
    2208.02814, eq. 4) of a loss of at most 1. With one they hold the loss of most scans: with this
    confidence, over the choice of the n, at most a share 1 − confidence of all scans loses more.
    `scans`: the number n, if another; the mean loss, or the number of bad scans, is then that of n.
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


def bad_share(bad: int, scans: int, confidence: float) -> float:
    """Return the upper bound of Clopper and Pearson of a share, 0…1, of which n scans show some."""
    low, high = bad / scans, 1.0
    for _ in range(60):
        middle = (low + high) / 2
        above = binomial(bad, scans, middle) > 1 - confidence
        low, high = (middle, high) if above else (low, middle)
    return high


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


@dataclass(frozen=True, slots=True)
class KeptLabels:
    """Coverage and risk of labels of which some were rejected; points are those scored."""

    points: int  # Number of points
    kept: int  # Of them, those with a label, and of these, wrong ones
    wrong: int
    people: int  # Number of points of people, and of them, kept with a label of something else
    missed_people: int
    classes: dict[str, tuple[int, int]]  # Kept points and wrong ones of them, by predicted class
    # Name, points, kept and wrong ones, of the scan with the largest share that is kept and wrong
    worst: tuple[str, int, int, int]

    @classmethod
    def of_confusion(
        cls, confusion: Confusion, space: LabelSpace, scans: Mapping[str, tuple[int, int, int]]
    ) -> Self:
        """Count the points whose predicted class is not 0; `scans`: as `worst`, by name."""
        matrix = confusion.counted(space.scored)
        kept, right = matrix[:, 1:].sum(axis=0), matrix.diagonal()[1:]
        pairs = zip(kept.tolist(), (kept - right).tolist(), strict=True)
        people = np.isin(space.names, PEOPLE)
        worst = max(scans, key=lambda name: scans[name][2] / max(scans[name][0], 1))
        return cls(
            points=int(matrix.sum()),
            kept=int(kept.sum()),
            wrong=int((kept - right).sum()),
            people=int(matrix[people].sum()),
            missed_people=int(matrix[people][:, 1:][:, ~people[1:]].sum()),
            classes={n: each for n, each in zip(space.names[1:], pairs, strict=True) if each[0]},
            worst=(worst, *scans[worst]),
        )

    @property
    def sentences(self) -> Iterator[str]:
        """The same for people, without the classes."""
        points, wrong = max(self.points, 1), self.wrong / max(self.kept, 1)
        text = f"kept: {self.kept / points:.1%} of {self.points:,} points, of which {wrong:.1%} are"
        yield f"{text} wrong ({self.wrong / points:.1%} of all)"
        name, in_worst, kept, errors = self.worst
        loss, risk = errors / max(in_worst, 1), errors / max(kept, 1)
        of_kept = f"{risk:.1%} of the {kept:,} kept"
        yield f"worst scan: {name}, {loss:.1%} of its points are kept and wrong, {of_kept}"
        if self.people:
            missed = f"{self.missed_people:,} of {self.people:,} points of people"
            yield f"missed people: {missed} are kept with a label of something else"


@dataclass(frozen=True, slots=True)
class KeptPromise:
    """Promise about scans beside the losses that were found, shares of their scored points."""

    at_most: float
    confidence: float | None  # None where the mean over the scans is at most that
    scans: int  # Number of scans, and of those of them that lose more
    above: int
    mean: float  # Mean loss, and the largest
    worst: float

    @classmethod
    def of_scans(
        cls, promised: Mapping[str, Any], scans: Mapping[str, tuple[int, int, int]]
    ) -> Self | None:
        """Compare with points, kept and wrong ones of scans, by name; None without any points."""
        losses = np.array([wrong / points for points, _, wrong in scans.values() if points])
        if not losses.size:
            return None
        above = int((losses > promised["at_most"]).sum())
        found = len(losses), above, float(losses.mean()), float(losses.max())
        return cls(promised["at_most"], promised["confidence"], *found)

    @property
    def sentence(self) -> str:
        """The same for people."""
        level, worst = f"{100 * self.at_most:.3g} %", f"{100 * self.worst:.1f} % in the worst"
        mean = f"{100 * self.mean:.1f} % on the mean of {counted(self.scans, 'scan')}"
        if self.confidence is None:
            lost = f"at most {level} of the points of known classes of a new scan kept and wrong"
            return f"promised: {lost}, on the mean; found: {mean}, {worst}"
        sure, rest = f"{100 * self.confidence:.3g} %", f"{100 - 100 * self.confidence:.3g} %"
        found = f"{self.above} of {counted(self.scans, 'scan')}"
        return (
            f"promised with {sure} confidence: at most {rest} of scans with more than {level} of "
            f"their points of known classes kept and wrong; found: {found}, {worst}"
        )


def promise(risk: Mapping[str, Any]) -> str:
    """Say what the threshold of weights holds for, of the `risk` in their card."""
    level, scans = f"{100 * risk['at_most']:.3g} %", counted(risk["scans"], "scan")
    kept = f"{risk['kind']} up to {risk['threshold']:.4g} kept"
    like = f"of the drives that it was chosen on ({scans} of {first_few(risk['sequences'])})"
    if risk["confidence"] is None:
        expected = f"{level} of the points of known classes are expected to be kept and wrong"
        return f"{kept}: of another scan {like}, at most {expected}"
    sure = f"{100 * risk['confidence']:.3g} %"
    rest = f"{100 - 100 * risk['confidence']:.3g} %"
    more = f"more than {level} of their points of known classes kept and wrong"
    return f"{kept}: with {sure} confidence, at most {rest} of scans {like} have {more}"
