# SPDX-License-Identifier: MIT
"""Merging of classes: several classes become one of another label space; probabilities add up.

Classes become the class of their raw ids in the other label space.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.classes.label_space import LabelSpace, built_in
from salsanext_cli.core.errors import UsageError, did_you_mean, first_few

MIN_MERGED_CLASSES = 2
"""Least number of classes after merging, ignored ones aside."""
MOVABLE = "moving"  # Name of all movable classes


@dataclass(frozen=True, slots=True, eq=False)
class ClassMerging:
    """Merging of C classes into K."""

    space: LabelSpace  # The K merged classes, with splits and ambiguous raw ids of both
    targets: tuple[int, ...]  # Merged train id, 0…K-1, of each of the C train ids

    @classmethod
    def between(cls, space: LabelSpace, merged: LabelSpace) -> ClassMerging:
        """Merge the classes of a label space into the classes of another one."""
        if problem := contradiction(space, merged):
            expected = f"merged classes of {space.name}"
            raise UsageError(f"label space {merged.name}", problem, expected)
        targets = tuple(_targets(space, merged, i)[0] for i in range(space.class_count))
        alternatives = {}
        for raw, several in space.alternatives.items():
            others = (targets[i] for i in several if i != space.learning_map[raw])
            # Those that become one class are no alternatives.
            if len(ids := {merged.learning_map[raw], *others}) > 1:
                alternatives[raw] = tuple(sorted(ids))
        alternatives |= merged.alternatives
        splits = merged.splits or space.splits
        return cls(replace(merged, splits=splits, alternatives=alternatives), targets)

    @classmethod
    def needed(cls, space: LabelSpace, merged: LabelSpace | None) -> ClassMerging | None:
        """Merge classes as `between`; None without other classes."""
        if merged is None:
            return None
        is_same = space.fits(merged) and np.array_equal(space.movable, merged.movable)
        if is_same and space.learning_map == merged.learning_map:
            return None
        merging = cls.between(space, merged)
        return None if is_same else merging

    @property
    def groups(self) -> tuple[tuple[int, ...], ...]:
        """Train ids of each of the K classes, possibly none."""
        every = range(self.space.class_count)
        return tuple(tuple(i for i, t in enumerate(self.targets) if t == k) for k in every)

    def add(self, probabilities: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Return probabilities (K, …) as sums of those of the classes, (C, …), in their order."""
        shape = (self.space.class_count, *probabilities.shape[1:])
        merged = np.zeros(shape, probabilities.dtype)
        for target, of_class in zip(self.targets, probabilities, strict=True):
            merged[target] += of_class
        # Rounded sums may exceed 1.
        return np.minimum(merged, 1, out=merged)


def is_merged(merged: LabelSpace, space: LabelSpace) -> bool:
    """Return whether the classes of a label space are merged classes of another."""
    return not space.fits(merged) and not contradiction(space, merged)


def contradiction(space: LabelSpace, merged: LabelSpace) -> str:
    """Return why the classes of a label space cannot be merged into another; empty if they can."""
    known = merged.learning_map
    if missing := sorted({*space.learning_map, *space.learning_map_inv.values()} - known.keys()):
        return f"lacks raw ids {first_few([_named(space, i) for i in missing])}"
    # Ids whose names mostly differ have other meanings. Ids that represent several do not count.
    several = {
        raw
        for one in (space, merged)
        for train_id, raw in one.learning_map_inv.items()
        if list(one.learning_map.values()).count(train_id) > 1
    }
    both = sorted((space.labels.keys() & merged.labels.keys()) - several)
    other = [i for i in both if space.labels[i] != merged.labels[i]]
    if 2 * len(other) > len(both):
        shown = [f"{merged.labels[i]} for raw id {_named(space, i)}" for i in other]
        return f"has other raw ids: {first_few(shown)}"
    every = range(space.class_count)
    split = [i for i in every if not space.ignored[i] and len(_targets(space, merged, i)) > 1]
    if split:
        names = (merged.names[k] for k in _targets(space, merged, split[0]))
        return f"splits {space.names[split[0]]} into {' and '.join(names)}"
    left = {_targets(space, merged, i)[0] for i in every if not space.ignored[i]}
    count = len({k for k in left if not merged.ignored[k]})
    if count < MIN_MERGED_CLASSES and not space.fits(merged):
        few = first_few([merged.names[k] for k in sorted(left)])
        return f"merges all {len(every)} classes into {few}"
    return ""


def named_classes(names: Collection[str], space: LabelSpace) -> npt.NDArray[np.bool_]:
    """Return the mask (C,) of the train ids of classes, coarse classes or `MOVABLE`, by name."""
    known: dict[str, npt.NDArray[np.bool_]] = {MOVABLE: space.movable}
    if MOVABLE in names:
        space.require_movable(f"class {MOVABLE}")
    coarse = built_in("coarse")
    if not contradiction(space, coarse):
        groups = zip(coarse.names, ClassMerging.between(space, coarse).groups, strict=True)
        known |= {name: np.isin(np.arange(space.class_count), ids) for name, ids in groups}
    known |= dict(zip(space.names, np.eye(space.class_count, dtype=bool), strict=True))
    if unknown := [name for name in names if name not in known]:
        hint = did_you_mean(unknown[0], known)
        expected = f"one of {', '.join(known)}"
        raise UsageError(f"class {unknown[0]}", "no such class", expected, hint)
    selected = np.zeros(space.class_count, bool)
    for name in names:
        selected |= known[name]
    return selected


def _targets(space: LabelSpace, merged: LabelSpace, train_id: int) -> list[int]:
    """Return the merged train ids of the raw ids of a class; only one for an ignored class."""
    # An ignored class contains everything without a class, some of which the other space may have.
    standing = space.learning_map_inv[train_id]
    of_class = {raw for raw, train in space.learning_map.items() if train == train_id}
    chosen = of_class - {standing} if not space.ignored[train_id] else set()
    first = merged.learning_map[standing]
    return [first, *sorted({merged.learning_map[raw] for raw in chosen} - {first})]


def _named(space: LabelSpace, raw: int) -> str:
    return f"{raw} ({space.labels[raw]})" if raw in space.labels else str(raw)
