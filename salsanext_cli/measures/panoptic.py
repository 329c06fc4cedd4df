# SPDX-License-Identifier: MIT
"""Panoptic quality, as SemanticKITTI's benchmark defines it (Kirillov et al., CVPR 2019).

A segment is all points of a scan with the same 32-bit label, instance and raw class id, whose truth
is not ignored. So the raw ids of one class, such as road and lane marking, are segments apart. Two
segments of a class match if their IoU is above 0.5. A segment of 50 points or more without a match
is a miss or a false alarm. SQ is the mean IoU of the matches, RQ their number over itself and half
of the misses and false alarms, PQ = SQ · RQ.
"""

from typing import Any

import numpy as np

from salsanext_cli.classes.label_space import LabelSpace, RawIds, TrainIds
from salsanext_cli.measures.scores import EPSILON, Mask, Ratios

MIN_SEGMENT_POINTS = 50
LABEL_BITS, INSTANCE = 32, 0xFFFF0000  # Bits of a label, and those of its instance
SEGMENT_COUNTS = 5  # Sum of IoU, matches, false alarms, misses and true objects, of each class
COLUMNS = ("pq", "sq", "rq", "matches", "false_alarms", "misses")


def count_segments(
    truth: tuple[TrainIds, RawIds], predicted: tuple[TrainIds, RawIds], scored: Mask
) -> Ratios:
    """Return `SEGMENT_COUNTS` of a scan, (C, 5) float64, by train ids and raw ids (N,)."""
    judged = scored[truth[0]]
    (true, of_true, true_sizes), (guessed, of_guessed, guessed_sizes) = (
        np.unique((train.astype(np.int64) << LABEL_BITS | raw)[judged], False, True, True)
        for train, raw in (truth, predicted)
    )
    pairs, common = np.unique(of_true * len(guessed) + of_guessed, return_counts=True)
    a, b = np.divmod(pairs, max(len(guessed), 1))
    iou = common / (true_sizes[a] + guessed_sizes[b] - common)
    hit = (true[a] >> LABEL_BITS == guessed[b] >> LABEL_BITS) & (iou > 0.5)
    a, b = a[hit], b[hit]
    misses, false_alarms = (sizes >= MIN_SEGMENT_POINTS for sizes in (true_sizes, guessed_sizes))
    misses[a] = false_alarms[b] = False
    segments = (true[a], true[a], guessed[false_alarms], true[misses], true[true & INSTANCE > 0])
    weights = (iou[hit], None, None, None, None)
    by_class = [
        np.bincount(each >> LABEL_BITS, weight, len(scored))
        for each, weight in zip(segments, weights, strict=True)
    ]
    return np.stack(by_class, axis=1).astype(np.float64) * scored[:, None]


def panoptic_quality(counts: Ratios, space: LabelSpace, things: Mask) -> dict[str, Any]:
    """Return `COLUMNS` of each class of counts (C, 5), and means of the qualities, as plain data.

    An absent class counts 0, as in the official evaluator, but for the last mean. `things` (C,):
    classes that consist of objects.
    """
    iou, matches, false_alarms, misses, _ = counts.T
    counted = matches + (false_alarms + misses) / 2
    sq, rq = iou / np.maximum(matches, EPSILON), matches / np.maximum(counted, EPSILON)
    quality = np.stack([sq * rq, sq, rq], axis=1)
    groups = {"all": space.scored, "things": space.scored & things, "stuff": space.scored & ~things}
    groups["things_present"] = groups["things"] & (counted > 0)
    means = {name: quality[of].mean(axis=0) for name, of in groups.items() if of.any()}
    classes = {}
    for i in np.flatnonzero(space.scored):
        numbers = [*quality[i].tolist(), *counts[i, 1:4].astype(int).tolist()]
        classes[space.names[i]] = dict(zip(COLUMNS, numbers, strict=True))
    of_groups = {n: dict(zip(COLUMNS, mean.tolist(), strict=False)) for n, mean in means.items()}
    return of_groups | {"classes": classes}
