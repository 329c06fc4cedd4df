# SPDX-License-Identifier: MIT
"""Targets of a training: train ids, and sets of them where a label may be any of several classes.

A data set says so by `LabelSpace.alternatives`. With C classes, target C + k is the k-th set.
"""

from collections.abc import Callable, Iterable

import numpy as np

from salsanext_cli.classes.label_space import RAW_ID_COUNT, UNKNOWN, LabelSpace, RawIds, TrainIds
from salsanext_cli.errors import UsageError
from salsanext_cli.records import Mask

ClassSets = tuple[tuple[int, ...], ...]  # Sets of train ids, each in rising order


def class_sets(spaces: Iterable[LabelSpace]) -> ClassSets:
    """Return the sets of several classes that labels of these spaces stand for."""
    spaces = list(spaces)
    sets = {several for space in spaces for several in space.alternatives.values()}
    ordered = tuple(sorted(several for several in sets if len(several) > 1))
    most = UNKNOWN - spaces[0].class_count
    if len(ordered) > most:
        raise UsageError("alternatives", f"{len(ordered)} different ones", f"at most {most}")
    return ordered


def to_targets(raw: RawIds, space: LabelSpace, sets: ClassSets, source: object) -> TrainIds:
    """Map raw ids (N,) to targets, (N,) uint8; an unknown id raises `LabelError`."""
    targets = space.to_train(raw, source=source)
    several = {i: each for i, each in space.alternatives.items() if each in sets}
    if not several:
        return targets
    table = np.zeros(RAW_ID_COUNT, np.uint8)
    table[list(several)] = [space.class_count + sets.index(each) for each in several.values()]
    of_sets: TrainIds = table[raw & 0xFFFF]
    return np.where(of_sets > 0, of_sets, targets)


def of_targets(of_classes: Mask, sets: ClassSets, rule: Callable[[Mask], np.bool_]) -> Mask:
    """Return (C,) bool of classes, and behind it what a rule makes of each set's, (C + K,)."""
    of_sets = [bool(rule(of_classes[list(several)])) for several in sets]
    return np.append(of_classes, np.array(of_sets, np.bool_))
