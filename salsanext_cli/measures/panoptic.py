# SPDX-License-Identifier: MIT
"""Panoptic quality, as SemanticKITTI's benchmark defines it (Kirillov et al., CVPR 2019).

A segment is all points of one class and one instance in a scan, without those whose truth is
ignored. Two segments of a class match if their IoU is above 0.5; what matches none is a miss or a
false alarm, from 50 points on::

    SQ_c = Σ IoU of matches / TP     RQ_c = TP / (TP + ½ FP + ½ FN)     PQ_c = SQ_c · RQ_c
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes.label_space import LabelSpace, RawIds, TrainIds
from salsanext_cli.measures.scores import EPSILON, plain

MIN_SEGMENT_POINTS = 50
"""Fewest points of a segment that counts although it matches none."""
INSTANCE_BITS = 16


@dataclass(slots=True, eq=False)
class Segments:
    """Counts of segments by class: (C,) each."""

    iou: npt.NDArray[np.float64]  # Sum over the matches
    matches: npt.NDArray[np.int64]
    false_alarms: npt.NDArray[np.int64]
    misses: npt.NDArray[np.int64]
    instances: int = 0  # Number of true segments with an instance

    @classmethod
    def none(cls, class_count: int) -> Segments:
        """Return the counts of no scan at all."""
        return cls(np.zeros(class_count), *(np.zeros(class_count, np.int64) for _ in range(3)))

    def __iadd__(self, other: Segments) -> Segments:
        self.iou += other.iou
        self.matches += other.matches
        self.false_alarms += other.false_alarms
        self.misses += other.misses
        self.instances += other.instances
        return self

    @classmethod
    def of_scan(
        cls,
        truth: tuple[TrainIds, RawIds],
        predicted: tuple[TrainIds, RawIds],
        scored: npt.NDArray[np.bool_],
    ) -> Segments:
        """Match the segments of a scan, of train ids and of raw ids with instances, (N,) each."""
        count, kept = len(scored), scored[truth[0]]
        true, of_true, true_sizes = _segments(*truth, kept)
        found, of_found, found_sizes = _segments(*predicted, kept)
        true_class, found_class = true >> INSTANCE_BITS, found >> INSTANCE_BITS
        pairs, common = np.unique(of_true * len(found) + of_found, return_counts=True)
        a, b = pairs // max(len(found), 1), pairs % max(len(found), 1)
        iou = common / (true_sizes[a] + found_sizes[b] - common)
        hit = (true_class[a] == found_class[b]) & (iou > 0.5)
        a, b, iou = a[hit], b[hit], iou[hit]

        def unmatched(
            classes: npt.NDArray[np.int64], sizes: npt.NDArray[np.intp], matched: Any
        ) -> npt.NDArray[np.int64]:
            alone = sizes >= MIN_SEGMENT_POINTS
            alone[matched] = False
            return np.bincount(classes[alone], minlength=count) * scored

        return cls(
            np.bincount(true_class[a], iou, count),
            np.bincount(true_class[a], minlength=count),
            unmatched(found_class, found_sizes, b),
            unmatched(true_class, true_sizes, a),
            int(np.count_nonzero(true & ((1 << INSTANCE_BITS) - 1))),
        )

    def to_dict(self, space: LabelSpace, things: npt.NDArray[np.bool_]) -> dict[str, Any]:
        """Return qualities as plain data: by class, and means over all, things and stuff.

        As in the official evaluator an absent class counts 0; the last mean is over things in the
        truth or the predictions alone. `things` (C,): classes that consist of objects.
        """
        scored, tp = space.scored, self.matches
        counted = tp + 0.5 * self.false_alarms + 0.5 * self.misses
        sq = self.iou / np.maximum(tp, EPSILON)
        rq = tp / np.maximum(counted, EPSILON)
        groups = {"all": scored, "things": scored & things, "stuff": scored & ~things}
        groups["things_present"] = groups["things"] & (counted > 0)
        means = {
            name: {
                key: float(values[of].mean()) if of.any() else float("nan")
                for key, values in (("pq", sq * rq), ("sq", sq), ("rq", rq))
            }
            for name, of in groups.items()
        }
        classes = [
            {
                **{"name": space.names[i], "pq": float(sq[i] * rq[i])},
                **{"sq": float(sq[i]), "rq": float(rq[i]), "matches": int(tp[i])},
                **{"false_alarms": int(self.false_alarms[i]), "misses": int(self.misses[i])},
            }
            for i in np.flatnonzero(scored)
        ]
        return dict(plain({**means, "classes": classes}))


def _segments(
    train: TrainIds, raw: RawIds, kept: npt.NDArray[np.bool_]
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Return class and instance of each segment, the segment of each kept point, and the sizes."""
    key = (train[kept].astype(np.int64) << INSTANCE_BITS) | (raw[kept] >> INSTANCE_BITS)
    return np.unique(key, return_inverse=True, return_counts=True)
