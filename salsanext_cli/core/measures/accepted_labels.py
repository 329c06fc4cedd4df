# SPDX-License-Identifier: MIT
"""Coverage and risk of the labels of a run that rejected some."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Self

import numpy as np

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.measures.scores import Counts, scored_rows
from salsanext_cli.core.texts import percentage

PEOPLE = ("person", "bicyclist", "motorcyclist", "person-or-cycle")
"""Classes whose points are of people."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AcceptedCounts:
    """Points of a scan of a run that rejected labels."""

    points: int  # Number of scored points
    accepted: int  # Number of scored points with a label
    wrong: int  # Number of accepted points with a wrong label

    @property
    def loss(self) -> float:
        """Share of the scored points that is accepted and wrong, 0…1; 0 without any."""
        return self.wrong / max(self.points, 1)


@dataclass(frozen=True, slots=True, kw_only=True)
class AcceptedLabels:
    """Coverage and risk of the labels of a run that rejected some, over scored points."""

    points: int  # Number of scored points
    accepted: int  # Number of points with a label
    wrong: int  # Number of wrong ones among them
    people: int  # Number of points of people
    missed_people: int  # Number of these accepted as something else
    # Accepted points and wrong ones among them, by name of the predicted class, people first
    classes: dict[str, tuple[int, int]]
    worst_scan: str  # Name of the scan with the largest share of wrong points
    worst: AcceptedCounts  # Points of this scan

    @classmethod
    def from_confusion(
        cls, confusion: Counts, space: LabelSpace, scans: Mapping[str, AcceptedCounts]
    ) -> Self:
        """Count the points whose predicted class is not 0.

        Parameters
        ----------
        confusion : (C, C) int64
            Points by true and predicted train id.
        space : LabelSpace
            Their classes.
        scans : mapping of str to AcceptedCounts
            Points of each scan by its name, at least one.

        Returns
        -------
        AcceptedLabels
        """
        matrix = scored_rows(confusion, space)
        accepted = matrix[:, 1:].sum(axis=0)
        right = matrix.diagonal()[1:]
        rows = zip(space.names[1:], accepted.tolist(), (accepted - right).tolist(), strict=True)
        classes = {name: (count, wrong) for name, count, wrong in rows if count}
        people = np.isin(space.names, PEOPLE)
        worst = max(scans, key=lambda name: scans[name].loss)
        return cls(
            points=int(matrix.sum()),
            accepted=int(accepted.sum()),
            wrong=int((accepted - right).sum()),
            people=int(matrix[people].sum()),
            missed_people=int(matrix[people][:, 1:][:, ~people[1:]].sum()),
            classes=dict(sorted(classes.items(), key=lambda item: item[0] not in PEOPLE)),
            worst_scan=worst,
            worst=scans[worst],
        )

    def to_dict(self) -> dict[str, object]:
        """Return plain data for JSON, in the form of all versions."""
        worst = self.worst
        return {
            "points": self.points,
            "accepted": self.accepted,
            "wrong": self.wrong,
            "people": self.people,
            "missed_people": self.missed_people,
            "classes": {name: list(pair) for name, pair in self.classes.items()},
            "worst": [self.worst_scan, worst.points, worst.accepted, worst.wrong],
        }

    @property
    def coverage(self) -> float:
        """Share of the points that is accepted, 0…1."""
        return self.accepted / max(self.points, 1)

    @property
    def risk(self) -> float:
        """Share of the accepted points that is wrong, 0…1."""
        return self.wrong / max(self.accepted, 1)

    @property
    def sentences(self) -> Iterator[str]:
        """Coverage, risk, the worst scan and missed people."""
        loss = percentage(self.wrong / max(self.points, 1))
        points = f"{self.points:,} points of known classes in all scans"
        wrong = f"{percentage(self.risk)} of the accepted are wrong ({loss} of all)"
        yield f"accepted: {percentage(self.coverage)} of {points}; {wrong}"
        worst = self.worst
        risk = f"{percentage(worst.wrong / max(worst.accepted, 1))} of the {worst.accepted:,}"
        loss = f"{percentage(worst.loss)} of its points are accepted and wrong"
        yield f"worst scan: {self.worst_scan}, {loss} ({risk} accepted)"
        if self.people:
            missed = f"{self.missed_people:,} of {self.people:,} points of people"
            yield f"missed people: {missed} are accepted, but not as people"
