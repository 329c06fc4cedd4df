# SPDX-License-Identifier: MIT
"""Threshold of an uncertainty chosen from labelled scans, with a promise about a new scan.

The loss of a scan at a threshold is the share of all its scored points that are kept and wrong; it
rises with the threshold. Scans, not points, are taken as exchangeable: those at hand and a new one
come in any order with the same chance. Arrays of losses are (n, T): scans by rising threshold.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Self

import numpy as np

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.errors import counted, first_few
from salsanext_cli.measures.scores import Confusion, Counts, Mask, Ratios

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


def possible_level(scans: int, confidence: float | None) -> float:
    """Return the least level that n scans can hold, or the highest confidence."""
    if confidence is None:
        return 1 / (scans + 1)
    low, high = 0.0, 1.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if middle**scans <= 1 - middle else (low, middle)
    return low


@dataclass(frozen=True, slots=True)
class KeptLabels:
    """Coverage and risk of labels of which some were rejected; points are those scored."""

    points: int  # Number of points
    kept: int  # Of them, those with a label, and of these, wrong ones
    wrong: int
    people: int  # Number of points of people, and of them, kept with a label of something else
    missed_people: int
    classes: dict[str, tuple[int, int]]  # Kept points and wrong ones of them, by predicted class
    # Name, kept points and wrong ones, of the scan with the largest share of wrong among its kept
    worst: tuple[str, int, int] | None

    @classmethod
    def of_confusion(
        cls, confusion: Confusion, space: LabelSpace, scans: Mapping[str, tuple[int, int]]
    ) -> Self:
        """Count the points whose predicted class is not 0; `scans`: as `worst`, by name."""
        matrix = confusion.counted(space.scored)
        of_class = matrix[:, 1:].sum(axis=0), matrix[:, 1:].sum(axis=0) - matrix.diagonal()[1:]
        people = is_people(space)
        missed = matrix[people][:, 1:][:, ~people[1:]].sum()
        counts = int(matrix.sum()), int(matrix[people].sum()), int(missed)
        return cls.of_classes(*counts, *of_class, space=space, scans=scans)

    @classmethod
    def of_classes(
        cls,
        points: int,
        people: int,
        missed: int,
        kept: Counts,
        wrong: Counts,
        *,
        space: LabelSpace,
        scans: Mapping[str, tuple[int, int]],
    ) -> Self:
        """Return the counts by name; `kept` and `wrong` are (C − 1,), without class 0."""
        classes = {
            name: (k, w)
            for name, k, w in zip(space.names[1:], kept.tolist(), wrong.tolist(), strict=True)
            if k
        }
        worst = max(scans, key=lambda name: share(*scans[name][::-1]), default=None)
        return cls(
            *(points, int(kept.sum()), int(wrong.sum()), people, missed, classes),
            worst=None if worst is None else (worst, *scans[worst]),
        )

    @property
    def sentences(self) -> Iterator[str]:
        """The same for people, without the classes."""
        kept, wrong = share(self.kept, self.points), share(self.wrong, self.kept)
        text = f"kept: {kept:.1%} of {self.points:,} points, of which {wrong:.1%} are wrong"
        yield f"{text} ({share(self.wrong, self.points):.1%} of all)"
        if self.worst:
            name, kept, wrong = self.worst
            yield f"worst scan: {name}, {share(wrong, kept):.1%} of {kept:,} kept points are wrong"
        if self.people:
            missed = f"{self.missed_people:,} of {self.people:,} points of people"
            yield f"missed people: {missed} are kept with a label of something else"

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        return asdict(self) | {"worst": self.worst and list(self.worst)}


def is_people(space: LabelSpace) -> Mask:
    """Say of each class, (C,), whether its points are of people."""
    return np.isin(space.names, PEOPLE)


def share(part: int, whole: int) -> float:
    """Return a share, 0…1; 0 of nothing."""
    return part / whole if whole else 0.0


def promise(risk: Mapping[str, Any]) -> str:
    """Say what the threshold of weights holds for, of the `risk` in their card."""
    level, scans = f"{100 * risk['at_most']:.3g} %", counted(risk["scans"], "scan")
    kept = f"{risk['kind']} up to {risk['threshold']:.4g} kept"
    like = f"like the {scans} of {first_few(risk['sequences'])} that it was chosen on"
    if risk["confidence"] is None:
        expected = f"{level} of the points are expected to be kept and wrong"
        return f"{kept}: of a new scan {like}, at most {expected}"
    sure = f"{100 * risk['confidence']:.3g} %"
    rest = f"{100 - 100 * risk['confidence']:.3g} %"
    more = f"more than {level} of their points kept and wrong"
    return f"{kept}: with {sure} confidence, at most {rest} of scans {like} have {more}"
