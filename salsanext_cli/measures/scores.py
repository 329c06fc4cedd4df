# SPDX-License-Identifier: MIT
"""Scores from counts, with the semantics and the numbers of the official SemanticKITTI evaluator.

The official formulas, with the points whose truth is ignored left out and n_tp the number of
points of true class t predicted as class p::

    IoU_c    = n_cc / (Σ_t n_tc + Σ_p n_cp − n_cc + 10⁻¹⁵)     0 for a class that is absent
    mean IoU = mean of IoU_c over all scored classes           absent ones included
    accuracy = Σ_c n_cc / (Σ_t Σ_p n_tp + 10⁻¹⁵)               p over scored classes only

So a labelled point predicted "unlabelled" lowers the IoU of its class, but the official accuracy
does not see it. `Scores.accuracy` is the plain share of labelled points that are right.
"""

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import yaml

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.measures.confusion import Confusion, Ratios, ratio

EPSILON = 1e-15
"""Added to every denominator by the official evaluator."""
FREQUENT_POINTS = 500
"""Points of a class from which on it is frequent; the IoU of fewer is mostly chance."""


@dataclass(frozen=True, slots=True)
class ClassScore:
    """Scores of one class; NaN where there is nothing to divide by."""

    name: str
    train_id: int
    iou: float  # Intersection over union; NaN if the class is in neither truth nor prediction
    iou_official: float  # The same by the official formula, 0 if absent
    # Share of the points predicted as this class that are of it; NaN if never predicted
    precision: float
    recall: float  # Share of the points of this class that were found; NaN if there are none
    points: int  # Number of points of this class
    predicted: int  # Number of labelled points predicted as this class


@dataclass(frozen=True, slots=True)
class Scores:
    """The scores of a set of points; shares are 0…1."""

    accuracy: float  # Share of labelled points that are right; NaN without any
    # The same as the official evaluator prints it: points predicted "unlabelled" left out
    accuracy_official: float
    iou_mean_official: float  # Mean IoU over all scored classes, an absent class counting 0
    # Mean IoU over the classes that the truth holds, whatever is predicted; NaN if it holds none
    iou_mean_present: float
    # The same over the classes with at least `FREQUENT_POINTS` points; NaN without any
    iou_mean_frequent: float
    points: int  # Number of labelled points
    classes: tuple[ClassScore, ...]  # Every scored class, in the order of the train ids

    def official_yaml(self) -> str:
        """Return the text of the official ``scores.txt``: sorted yaml, every digit."""
        numbers = {"accuracy_mean": self.accuracy_official, "iou_mean": self.iou_mean_official}
        numbers |= {f"iou_{c.name}": c.iou_official for c in self.classes}
        return yaml.safe_dump(numbers, default_flow_style=False, allow_unicode=True)

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON; null stands for NaN."""
        data: dict[str, Any] = plain(asdict(self))
        return data


def scores(confusion: Confusion, space: LabelSpace) -> Scores:
    """Divide the counts.

    `confusion`: counts over the train ids of `space`; `space`: names of the classes, and which of
    them are ignored.
    """
    scored = space.scored
    matrix = confusion.counted(scored)
    hits, truths, predictions = np.diagonal(matrix), matrix.sum(axis=1), matrix.sum(axis=0)
    union = truths + predictions - hits
    iou, iou_official = ratio(hits, union), hits / (union + EPSILON)
    precision, recall = ratio(hits, predictions), ratio(hits, truths)
    return Scores(
        accuracy=float(ratio(hits.sum(keepdims=True), matrix.sum(keepdims=True).ravel())[0]),
        accuracy_official=float(hits.sum() / (matrix[:, scored].sum() + EPSILON)),
        iou_mean_official=_mean(iou_official[scored]),
        iou_mean_present=_mean(iou[scored & (truths > 0)]),
        iou_mean_frequent=_mean(iou[scored & (truths >= FREQUENT_POINTS)]),
        points=int(matrix.sum()),
        classes=tuple(
            ClassScore(
                name=space.names[i],
                train_id=int(i),
                iou=float(iou[i]),
                iou_official=float(iou_official[i]),
                precision=float(precision[i]),
                recall=float(recall[i]),
                points=int(truths[i]),
                predicted=int(predictions[i]),
            )
            for i in np.flatnonzero(scored)
        ),
    )


def _mean(values: Ratios) -> float:
    return float(values.mean()) if len(values) else math.nan


def plain(value: Any) -> Any:
    """Return data for JSON: arrays and tuples as lists, NaN as None."""
    match value:
        case float():
            return None if math.isnan(value) else value
        case dict():
            return {key: plain(each) for key, each in value.items()}
        case list() | tuple():
            return [plain(each) for each in value]
        case np.ndarray():
            return plain(value.tolist())
    return value
