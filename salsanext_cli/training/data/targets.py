# SPDX-License-Identifier: MIT
"""Targets of a training: train ids, or sets of them for labels of several classes.

`LabelSpace.alternatives` defines these labels. With C classes, target C + k is the k-th set.
"""

from collections.abc import Callable, Iterable

import numpy as np

from salsanext_cli.core.classes.label_space import LabelSpace, RawIds, TrainIds
from salsanext_cli.core.classes.label_tables import RAW_ID_COUNT, UNKNOWN
from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.records import Mask

ClassSets = tuple[tuple[int, ...], ...]  # Sets of train ids, each in rising order


def class_sets(spaces: Iterable[LabelSpace]) -> ClassSets:
    """Return the sets of several classes among the labels of these spaces."""
    spaces = list(spaces)
    sets = {train_ids for space in spaces for train_ids in space.alternatives.values()}
    ordered = tuple(sorted(train_ids for train_ids in sets if len(train_ids) > 1))
    most = UNKNOWN - spaces[0].class_count
    if len(ordered) > most:
        raise UsageError("alternatives", f"are {len(ordered)} sets of classes", f"at most {most}")
    return ordered


def to_targets(raw: RawIds, space: LabelSpace, sets: ClassSets, source: object) -> TrainIds:
    """Map raw ids (N,) to targets, (N,) uint8; an unknown id raises `LabelError`."""
    targets = space.to_train(raw, source=source)
    indices = {i: sets.index(s) for i, s in space.alternatives.items() if s in sets}
    if not indices:
        return targets
    table = np.zeros(RAW_ID_COUNT, np.uint8)
    table[list(indices)] = [space.class_count + index for index in indices.values()]
    set_targets: TrainIds = table[raw & 0xFFFF]
    return np.where(set_targets > 0, set_targets, targets)


def target_mask(class_mask: Mask, sets: ClassSets, rule: Callable[[Mask], np.bool_]) -> Mask:
    """Append to the values of classes (C,) the result of a rule for each set, (C + K,) bool."""
    set_mask = [bool(rule(class_mask[list(train_ids)])) for train_ids in sets]
    return np.append(class_mask, np.array(set_mask, np.bool_))
