# SPDX-License-Identifier: MIT
"""Panoptic quality, as SemanticKITTI's benchmark defines it (Kirillov et al., CVPR 2019).

A segment is all points of a scan with the same 32-bit label (instance and raw class id) whose truth
is not ignored. So raw ids of one class, such as road and lane marking, are separate segments. Two
segments of a class match if their IoU is above 0.5. A segment of 50 points or more without a match
is a miss or a false alarm. SQ is the mean IoU of the matches, RQ is matches / (matches + misses / 2
+ false alarms / 2), PQ = SQ · RQ.
"""

from typing import Any

import numpy as np

from salsanext_cli.core.classes.label_space import LabelSpace, RawIds, TrainIds
from salsanext_cli.core.measures.scores import EPSILON, Ratios
from salsanext_cli.core.records import Mask

MIN_SEGMENT_POINTS = 50
LABEL_BITS = 32
COLUMNS = ("pq", "sq", "rq", "matches", "false_alarms", "misses")


def count_segments(
    truth: tuple[TrainIds, RawIds], predicted: tuple[TrainIds, RawIds], scored: Mask
) -> Ratios:
    """Return sum of IoU, matches, false alarms and misses by class, (C, 4) float64.

    `truth`, `predicted`: train ids and raw ids (N,) of the points of a scan.
    """
    judged = scored[truth[0]]
    (true, of_true, true_sizes), (predictions, of_prediction, predicted_sizes) = (
        np.unique((train.astype(np.int64) << LABEL_BITS | raw)[judged], False, True, True)
        for train, raw in (truth, predicted)
    )
    pairs, common = np.unique(of_true * len(predictions) + of_prediction, return_counts=True)
    a, b = np.divmod(pairs, max(len(predictions), 1))
    iou = common / (true_sizes[a] + predicted_sizes[b] - common)
    hit = (true[a] >> LABEL_BITS == predictions[b] >> LABEL_BITS) & (iou > 0.5)
    a, b = a[hit], b[hit]
    misses, false_alarms = (sizes >= MIN_SEGMENT_POINTS for sizes in (true_sizes, predicted_sizes))
    misses[a] = false_alarms[b] = False
    segments = (true[a], true[a], predictions[false_alarms], true[misses])
    weights = (iou[hit], None, None, None)
    by_class = [
        np.bincount(labels >> LABEL_BITS, weight, len(scored))
        for labels, weight in zip(segments, weights, strict=True)
    ]
    return np.stack(by_class, axis=1).astype(np.float64) * scored[:, None]


def panoptic_quality(counts: Ratios, space: LabelSpace, things: Mask) -> dict[str, Any]:
    """Return `COLUMNS` of each class of counts (C, 4), and means of the qualities, as plain data.

    An absent class counts 0, as in the official evaluator, except in `things_present`. `things`
    (C,): classes that consist of objects.
    """
    iou, matches, false_alarms, misses = counts.T
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
