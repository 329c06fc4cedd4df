# SPDX-License-Identifier: MIT
"""Differences of the scores of two runs on the same scans, with intervals of a paired bootstrap.

Neighbouring scans of a drive show the same things, so that scans are not drawn one by one. Each
resample draws whole drives, the same for both runs. Few drives are divided into long parts of
consecutive scans. The percentiles of resamples of few parts are too close to each other, so that
the intervals are widened as those of Student's t are.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.measures.scores import Counts, Ratios, ratio
from salsanext_cli.core.records import Indices, Mask

PARTS = 20  # Largest number of parts into which the scans of few drives are divided
MIN_SCANS = 50  # Least number of scans of a part of a drive; shorter parts show the same things
MIN_PARTS = 5  # Fewer parts have no interval: their resamples are too much alike
RESAMPLES = 1000
SEED = 0
INTERVAL = (2.5, 97.5)  # Percentiles of the resampled differences
NORMAL_QUANTILE = 1.959964  # Of 97.5 %


@dataclass(frozen=True, slots=True, kw_only=True)
class Difference:
    """Score of two runs on the same scans, 0…1, and the 95 % interval of its change."""

    before: float
    after: float
    low: float | None  # Lower end of the interval; None if too few parts have points of it
    high: float | None  # Its upper end

    @property
    def change(self) -> float:
        """Score of the second run minus that of the first."""
        return self.after - self.before

    @property
    def is_clear(self) -> bool:
        """Whether the interval excludes 0."""
        return self.low is not None and self.high is not None and (self.low > 0 or self.high < 0)

    def to_dict(self) -> dict[str, object]:
        """Return plain data for JSON."""
        return {
            "before": self.before,
            "after": self.after,
            "low": self.low,
            "high": self.high,
            "change": self.change,
            "clear": self.is_clear,
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class ScoreDifferences:
    """Differences of the scores of two runs."""

    accuracy: Difference
    iou_mean: Difference  # Mean over the classes in the truth
    classes: dict[int, Difference]  # IoU of the classes in the truth, by train id
    parts: int  # Number of parts that the resamples draw from


def class_sums(matrix: Counts) -> Counts:
    """Return points (3, C) of a confusion matrix (C, C): right, of each class, predicted as it."""
    return np.stack([np.diagonal(matrix), matrix.sum(axis=1), matrix.sum(axis=0)])


def consecutive_parts(sequences: Sequence[str]) -> Indices:
    """Return the part of each scan: a sequence, or consecutive scans if there are few sequences.

    A part of a sequence has at least `MIN_SCANS` scans; a whole sequence may have fewer.

    Parameters
    ----------
    sequences : sequence of str
        Sequence of each scan; scans are in the order of their drives.

    Returns
    -------
    (S,) int64
        Numbers of the parts, from 0 on.
    """
    names, starts, counts = np.unique(sequences, return_index=True, return_counts=True)
    parts_of_each = 1 if len(names) >= MIN_PARTS else -(-PARTS // max(len(names), 1))
    parts = np.empty(len(sequences), np.int64)
    number = 0
    for start, count in zip(starts.tolist(), counts.tolist(), strict=True):
        parts_of_sequence = max(1, min(parts_of_each, count // MIN_SCANS))
        for scans in np.array_split(np.arange(start, start + count), parts_of_sequence):
            parts[scans] = number
            number += 1
    return parts


def score_differences(sums: Counts, parts: Indices) -> ScoreDifferences | None:
    """Compare the scores of two runs.

    A score has an interval only if at least `MIN_PARTS` parts have points that it is about.

    Parameters
    ----------
    sums : (S, 2, 3, C) int64
        `class_sums` of the scored points of S scans, by the first and by the second run.
    parts : (S,) int64
        Part of each scan, as of `consecutive_parts`.

    Returns
    -------
    ScoreDifferences or None
        None without scored points.
    """
    present = sums[:, 0, 1].sum(axis=0) > 0
    if not present.any():
        return None
    count = int(parts.max()) + 1
    sums_of_parts = np.zeros((count, *sums.shape[1:]), np.int64)
    np.add.at(sums_of_parts, parts, sums)
    scores = _scores(_resampled(sums_of_parts), present)
    scores_of_runs = scores[0]
    changes = scores[:, 1] - scores[:, 0]
    bounds = _intervals(changes[0], changes[1:], _parts_of_scores(sums_of_parts))
    differences = [
        Difference(before=before, after=after, low=low, high=high)
        for (before, after), (low, high) in zip(scores_of_runs.T.tolist(), bounds, strict=True)
    ]
    return ScoreDifferences(
        accuracy=differences[0],
        iou_mean=differences[1],
        classes={i: differences[2 + i] for i in np.flatnonzero(present).tolist()},
        parts=count,
    )


def _resampled(sums: Counts) -> Counts:
    """Return the sums of all parts (U, 2, 3, C), then of resamples of the parts: (1 + R, 2, 3, C).

    There are no resamples of few parts.
    """
    random = np.random.default_rng(SEED)
    count = len(sums)
    flat = sums.reshape(count, -1)
    totals = [flat.sum(axis=0)]
    for _ in range(RESAMPLES if count >= MIN_PARTS else 0):
        times_drawn = np.bincount(random.integers(count, size=count), minlength=count)
        totals.append(times_drawn @ flat)
    return np.array(totals).reshape(-1, *sums.shape[1:])


def _scores(sums: Counts, present: Mask) -> Ratios:
    """Return accuracy, mean IoU of present classes, and IoUs, (R, 2, 2 + C), of sums (R, 2, 3, C).

    A class that a resample lacks does not count in its mean.
    """
    hits = sums[:, :, 0]
    truths = sums[:, :, 1]
    predictions = sums[:, :, 2]
    ious = ratio(hits, truths + predictions - hits)
    accuracy = ratio(hits.sum(axis=-1), truths.sum(axis=-1))
    # The truth is the same for both runs, and so are the classes of the mean.
    counted = present & (truths > 0)
    total = np.where(counted, ious, 0).sum(axis=-1)
    mean = ratio(total, counted.sum(axis=-1))
    return np.concatenate([accuracy[..., None], mean[..., None], ious], axis=-1)


def _parts_of_scores(sums: Counts) -> Indices:
    """Return how many parts have points of accuracy, mean IoU and IoUs, (2 + C,), of sums of parts.

    `sums`: (U, 2, 3, C), as of `class_sums`.
    """
    has_class = sums[:, 0, 1] > 0
    scored = np.count_nonzero(has_class.any(axis=1))
    return np.concatenate([[scored, scored], np.count_nonzero(has_class, axis=0)])


def _intervals(
    changes: Ratios, resampled: Ratios, parts: Indices
) -> list[tuple[float | None, float | None]]:
    """Return the ends of the interval of each change; None if too few parts have points of it.

    `changes`: (K,); `resampled`: (R, K), NaN where a resample lacks a class; `parts`: (K,), number
    of parts with points of the score.
    """
    intervals: list[tuple[float | None, float | None]] = []
    for change, column, count in zip(changes.tolist(), resampled.T, parts.tolist(), strict=True):
        changes_of_score = column[~np.isnan(column)]
        if count >= MIN_PARTS and len(changes_of_score):
            low, high = np.percentile(changes_of_score, INTERVAL).tolist()
            factor = widening(count)
            intervals.append((change + factor * (low - change), change + factor * (high - change)))
        else:
            intervals.append((None, None))
    return intervals


def widening(parts: int) -> float:
    """Return the factor of the width of an interval from resamples of a number of parts.

    The resamples spread by the deviation of the parts with n in place of n - 1 as its divisor, and
    their percentiles are those of a normal distribution, not of Student's t with n - 1 degrees of
    freedom. Its quantile is that of Abramowitz and Stegun, 26.7.5.
    """
    z = NORMAL_QUANTILE
    freedom = parts - 1
    quantile = (
        z
        + (z**3 + z) / (4 * freedom)
        + (5 * z**5 + 16 * z**3 + 3 * z) / (96 * freedom**2)
        + (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / (384 * freedom**3)
    )
    return quantile / z * math.sqrt(parts / freedom)


def agreement(transitions: npt.NDArray[np.int64]) -> float:
    """Return the share of points with the same label, 0…1, of those that either run labelled.

    Parameters
    ----------
    transitions : (C, C) int64
        Points by train id of the first run and of the second; 0 is no label.
    """
    points = int(transitions.sum() - transitions[0, 0])
    return int(transitions.trace() - transitions[0, 0]) / points if points else 1.0
