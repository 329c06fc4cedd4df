# SPDX-License-Identifier: MIT
"""Differences of the scores of two runs on the same scans, with intervals of a paired bootstrap.

Neighbouring scans of a drive show the same things, so that scans are not drawn one by one. Each
resample draws whole drives, the same for both runs. Few drives are divided into parts of
consecutive scans.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.measures.scores import Counts, Ratios, ratio
from salsanext_cli.core.records import Indices, Mask

PARTS = 20  # Number of parts into which the scans of few drives are divided, if there are so many
MIN_PARTS = 5  # Fewer parts have no interval: their resamples are too much alike
RESAMPLES = 1000
SEED = 0
INTERVAL = (2.5, 97.5)  # Percentiles of the resampled differences


@dataclass(frozen=True, slots=True, kw_only=True)
class Difference:
    """Score of two runs on the same scans, 0…1, and the 95 % interval of its change."""

    before: float
    after: float
    low: float | None  # Lower end of the interval; None if there are too few scans
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
        for scans in np.array_split(np.arange(start, start + count), min(parts_of_each, count)):
            parts[scans] = number
            number += 1
    return parts


def score_differences(sums: Counts, parts: Indices) -> ScoreDifferences | None:
    """Compare the scores of two runs.

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
    bounds = _intervals(scores[1:, 1] - scores[1:, 0])
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


def _intervals(changes: Ratios) -> list[tuple[float | None, float | None]]:
    """Return the ends of the interval of each column of resampled changes (R, K); None without."""
    intervals: list[tuple[float | None, float | None]] = []
    for column in changes.T:
        changes_of_score = column[~np.isnan(column)]
        if len(changes_of_score):
            low, high = np.percentile(changes_of_score, INTERVAL)
            intervals.append((float(low), float(high)))
        else:
            intervals.append((None, None))
    return intervals


def agreement(turned: npt.NDArray[np.int64]) -> float:
    """Return the share of points with the same label, 0…1, of those that either run labelled.

    Parameters
    ----------
    turned : (C, C) int64
        Points by train id of the first run and of the second; 0 is no label.
    """
    points = int(turned.sum() - turned[0, 0])
    return int(turned.trace() - turned[0, 0]) / points if points else 1.0
