# SPDX-License-Identifier: MIT
"""Merging of classes: several of a label space become one of another, and their probabilities add.

Which becomes which follows from the raw ids: each class goes where the other label space puts the
raw ids of which it consists.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.errors import UsageError, first_few

MIN_MERGED_CLASSES = 2
"""Classes that merging must leave, "unlabelled" and other ignored ones aside."""


@dataclass(frozen=True, slots=True, eq=False)
class ClassMerging:
    """Merging of C classes into K."""

    # The K merged classes. Its splits are those of the other label space if it has none; its
    # alternatives are those of both, where they are still of several classes
    space: LabelSpace
    targets: tuple[int, ...]  # Train id, 0…K-1, that each train id becomes

    @classmethod
    def between(cls, own: LabelSpace, merged: LabelSpace) -> ClassMerging:
        """Merge the classes of a label space into those of another one."""
        # An ignored class stands for what has no class of its own, some of which the other may
        # have: it goes where the other puts the raw id that stands for it.
        if problem := contradiction(own, merged):
            expected = f"the classes of {own.name}, merged"
            raise UsageError(f"label space {merged.name}", problem, expected)
        targets = tuple(_targets(own, merged, i)[0] for i in range(own.class_count))
        alternatives = _alternatives(own, merged, targets) | merged.alternatives
        splits = merged.splits or own.splits
        return cls(replace(merged, splits=splits, alternatives=alternatives), targets)

    @classmethod
    def needed(cls, own: LabelSpace, merged: LabelSpace | None) -> ClassMerging | None:
        """Merge classes as `between`; None if no others are given or they are the same."""
        if merged is None:
            return None
        is_same = own.fits(merged) and np.array_equal(own.movable, merged.movable)
        if is_same and own.learning_map == merged.learning_map:
            return None
        merging = cls.between(own, merged)
        return None if is_same else merging

    @property
    def groups(self) -> tuple[tuple[int, ...], ...]:
        """Train ids that become each of the K; of some classes there may be none."""
        every = range(self.space.class_count)
        return tuple(tuple(i for i, t in enumerate(self.targets) if t == k) for k in every)

    def add(self, probabilities: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Add the probabilities of merged classes, (C, …) to (K, …), in the order of train ids."""
        shape = (self.space.class_count, *probabilities.shape[1:])
        merged = np.zeros(shape, probabilities.dtype)
        for target, of_class in zip(self.targets, probabilities, strict=True):
            merged[target] += of_class
        # Rounded sums may exceed 1.
        return np.minimum(merged, 1, out=merged)


def is_merged(merged: LabelSpace, own: LabelSpace) -> bool:
    """Say whether the classes of a label space are merged ones of another's."""
    return not own.fits(merged) and not contradiction(own, merged)


def contradiction(own: LabelSpace, merged: LabelSpace) -> str:
    """Return why the classes of a label space cannot be merged into another's, empty if they can.

    Where most raw ids of both have other names, they are of two systems of ids.
    """
    known, standing = merged.learning_map, _standing_for_several(own, merged)
    if missing := sorted({*own.learning_map, *own.learning_map_inv.values()} - known.keys()):
        return f"no raw id {first_few([_named(own, i) for i in missing])}"
    both = sorted((own.labels.keys() & merged.labels.keys()) - standing)
    other = [i for i in both if own.labels[i] != merged.labels[i]]
    if 2 * len(other) > len(both):
        shown = [f"{merged.labels[i]} for raw id {_named(own, i)}" for i in other]
        return first_few(shown)
    every = range(own.class_count)
    split = [i for i in every if not own.ignored[i] and len(_targets(own, merged, i)) > 1]
    if split:
        names = (merged.names[k] for k in _targets(own, merged, split[0]))
        return f"{own.names[split[0]]} is split into {' and '.join(names)}"
    left = {_targets(own, merged, i)[0] for i in every if not own.ignored[i]}
    count = len({k for k in left if not merged.ignored[k]})
    if count < MIN_MERGED_CLASSES and not own.fits(merged):
        few = first_few([merged.names[k] for k in sorted(left)])
        return f"all {len(every)} classes become {few}"
    return ""


def _standing_for_several(*spaces: LabelSpace) -> set[int]:
    """Return the raw ids that stand for a class of several in one of the label spaces."""
    return {
        raw
        for space in spaces
        for train_id, raw in space.learning_map_inv.items()
        if list(space.learning_map.values()).count(train_id) > 1
    }


def _targets(own: LabelSpace, merged: LabelSpace, train_id: int) -> list[int]:
    """Return the train ids that the raw ids of a class become; of an ignored class only one."""
    standing = own.learning_map_inv[train_id]
    of_class = {raw for raw, train in own.learning_map.items() if train == train_id}
    chosen = of_class - {standing} if not own.ignored[train_id] else set()
    first = merged.learning_map[standing]
    return [first, *sorted({merged.learning_map[raw] for raw in chosen} - {first})]


def _alternatives(
    own: LabelSpace, merged: LabelSpace, targets: Sequence[int]
) -> dict[int, tuple[int, ...]]:
    """Return what the alternatives become; several that become one class are none any more."""
    merged_ids = {
        raw: {
            merged.learning_map[raw],
            *(targets[i] for i in several if i != own.learning_map[raw]),
        }
        for raw, several in own.alternatives.items()
    }
    return {raw: tuple(sorted(several)) for raw, several in merged_ids.items() if len(several) > 1}


def _named(space: LabelSpace, raw: int) -> str:
    return f"{raw} ({space.labels[raw]})" if raw in space.labels else str(raw)
