# SPDX-License-Identifier: MIT
"""Confusion matrix, and its scores by the formulas of the official SemanticKITTI evaluator.

With n_tp the number of points of true class t predicted as class p, without points whose truth is
ignored::

    IoU_c    = n_cc / (Σ_t n_tc + Σ_p n_cp − n_cc + 10⁻¹⁵)     0 for a class that is absent
    mean IoU = mean of IoU_c over all scored classes           including absent ones
    accuracy = Σ_c n_cc / (Σ_t Σ_p n_tp + 10⁻¹⁵)               p over scored classes only

So a labelled point predicted "unlabelled" lowers the IoU of its class, but not the official
accuracy. `Scores.accuracy` is the plain share of labelled points that are right.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import yaml

from salsanext_cli.core.classes.label_space import LabelSpace

Counts = npt.NDArray[np.int64]
Ratios = npt.NDArray[np.float64]

EPSILON = 1e-15  # Added to every denominator by the official evaluator
FREQUENT_POINTS = 500  # Of a class; the IoU of fewer is mostly chance


def confusion_matrix(
    truth: npt.NDArray[Any], predicted: npt.NDArray[Any], class_count: int
) -> Counts:
    """Count pairs of train ids, including ignored ones.

    Parameters
    ----------
    truth : integer array
        True train ids 0…C-1.
    predicted : integer array
        Predicted train ids, of the same shape.
    class_count : int
        C, the number of classes.

    Returns
    -------
    (C, C) int64
        Points by true and predicted train id.
    """
    size = (class_count, class_count)
    cell = np.ravel_multi_index((truth.ravel(), predicted.ravel()), size)
    return np.bincount(cell, minlength=class_count**2).reshape(size)


def scored_rows(confusion: Counts, space: LabelSpace) -> Counts:
    """Return the matrix (C, C) with rows of 0 for ignored classes; their columns are misses."""
    return np.where(space.scored[:, None], confusion, 0)


def accepted(confusion: Counts) -> Counts:
    """Return the matrix (C, C) without the points predicted as class 0, which have no label."""
    return np.where(np.arange(len(confusion)) > 0, confusion, 0)


def ratio(numerator: Counts, denominator: Counts) -> Ratios:
    """Divide counts; NaN where there is nothing to divide by."""
    quotient: Ratios = np.full(denominator.shape, np.nan)
    np.divide(numerator, denominator, out=quotient, where=denominator > 0)
    return quotient


@dataclass(frozen=True, slots=True, kw_only=True)
class ClassScore:
    """Scores of one class; NaN where there is nothing to divide by."""

    name: str
    train_id: int
    iou: float  # Intersection over union; NaN if the class is in neither truth nor prediction
    iou_official: float  # The same by the official formula, 0 if absent
    precision: float  # Share of the points predicted as this class that are of it
    recall: float  # Share of the points of this class that were predicted as it
    points: int  # Number of points of this class
    predicted: int  # Number of labelled points predicted as this class


@dataclass(frozen=True, slots=True, kw_only=True)
class Scores:
    """Scores of a set of points; shares are 0…1."""

    accuracy: float  # Share of labelled points that are right; NaN without any
    accuracy_official: float  # The same without the points predicted "unlabelled"
    iou_mean_official: float  # Mean IoU over all scored classes, an absent class counting 0
    iou_mean_present: float  # Mean IoU over the classes in the truth; NaN without any
    iou_mean_frequent: float  # The same over classes of at least `FREQUENT_POINTS` points
    points: int  # Number of labelled points
    classes: tuple[ClassScore, ...]  # Every scored class, in the order of the train ids

    def official_yaml(self) -> str:
        """Return the text of the official ``scores.txt``: sorted yaml, every digit."""
        numbers = {"accuracy_mean": self.accuracy_official, "iou_mean": self.iou_mean_official}
        numbers |= {f"iou_{c.name}": c.iou_official for c in self.classes}
        return yaml.safe_dump(numbers, default_flow_style=False, allow_unicode=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class BandScores:
    """Scores of the points in a band of distances."""

    name: str
    scores: Scores
    iou_mean_same: float  # Mean IoU over the classes in the truth of every band with points
    absent: list[str]  # Names of the classes in the truth of other bands only


def band_scores(bands: Mapping[str, Scores]) -> list[BandScores]:
    """Return the scores of bands of distances, which are compared over the same classes.

    Parameters
    ----------
    bands : mapping of str to Scores
        Scores by name of the band.

    Returns
    -------
    list of BandScores
    """
    present = {name: {c.name for c in band.classes if c.points} for name, band in bands.items()}
    every = {name for names in present.values() for name in names}
    same = {name for name in every if all(name in names for names in present.values() if names)}
    results = []
    for name, band in bands.items():
        ious = [c.iou for c in band.classes if c.name in same & present[name]]
        absent = sorted(every - present[name])
        mean = _mean(np.array(ious))
        results.append(BandScores(name=name, scores=band, iou_mean_same=mean, absent=absent))
    return results


@dataclass(frozen=True, slots=True, kw_only=True)
class Confusion:
    """Points of one class that were predicted as another."""

    true: int  # Train id
    predicted: int  # Train id
    points: int


def largest_confusions(matrix: Counts, most: int) -> list[Confusion]:
    """Return the most frequent confusions, the first of them the largest.

    Parameters
    ----------
    matrix : (C, C) int64
        Points by true and predicted train id.
    most : int
        Largest number of confusions to return.

    Returns
    -------
    list of Confusion
    """
    off_diagonal = np.where(np.eye(len(matrix), dtype=bool), 0, matrix)
    largest = np.argsort(-off_diagonal, axis=None, kind="stable")[:most]
    confusions = []
    for cell in largest.tolist():
        true, predicted = divmod(cell, len(matrix))
        points = int(off_diagonal[true, predicted])
        if points:
            confusions.append(Confusion(true=true, predicted=predicted, points=points))
    return confusions


def scores(confusion: Counts, space: LabelSpace) -> Scores:
    """Divide the counts (C, C) of a confusion matrix over the train ids of a label space."""
    scored = space.scored
    matrix = scored_rows(confusion, space)
    points = int(matrix.sum())
    hits = matrix.diagonal()
    truths = matrix.sum(axis=1)
    predictions = matrix.sum(axis=0)
    union = truths + predictions - hits
    iou = ratio(hits, union)
    iou_official = hits / (union + EPSILON)
    precision = ratio(hits, predictions)
    recall = ratio(hits, truths)
    classes = [
        ClassScore(
            name=space.names[i],
            train_id=i,
            iou=float(iou[i]),
            iou_official=float(iou_official[i]),
            precision=float(precision[i]),
            recall=float(recall[i]),
            points=int(truths[i]),
            predicted=int(predictions[i]),
        )
        for i in np.flatnonzero(scored).tolist()
    ]
    return Scores(
        accuracy=float(hits.sum() / points) if points else math.nan,
        accuracy_official=float(hits.sum() / (matrix[:, scored].sum() + EPSILON)),
        iou_mean_official=_mean(iou_official[scored]),
        iou_mean_present=_mean(iou[scored & (truths > 0)]),
        iou_mean_frequent=_mean(iou[scored & (truths >= FREQUENT_POINTS)]),
        points=points,
        classes=tuple(classes),
    )


def _mean(values: Ratios) -> float:
    return float(values.mean()) if len(values) else math.nan
