# SPDX-License-Identifier: MIT
"""Merging of classes: several classes become one of another label space; probabilities add up.

Classes become the class of their raw ids in the other label space.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.classes.label_space import LabelSpace, built_in
from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.texts import did_you_mean, first_few

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
        problem = contradiction(space, merged)
        if problem:
            expected = f"merged classes of {space.name}"
            raise UsageError(f"label space {merged.name}", problem, expected)
        targets = tuple(_targets(space, merged, i)[0] for i in range(space.class_count))
        alternatives = _merged_alternatives(space, merged, targets) | merged.alternatives
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
        groups: list[list[int]] = [[] for _ in range(self.space.class_count)]
        for train_id, target in enumerate(self.targets):
            groups[target].append(train_id)
        return tuple(map(tuple, groups))

    def add(self, probabilities: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Add the probabilities of merged classes.

        Parameters
        ----------
        probabilities : (C, …) array
            Probabilities of the classes before.

        Returns
        -------
        (K, …) array
            Sums in the order of the classes, of the same dtype, at most 1.
        """
        shape = (self.space.class_count, *probabilities.shape[1:])
        merged = np.zeros(shape, probabilities.dtype)
        for target, probability in zip(self.targets, probabilities, strict=True):
            merged[target] += probability
        # Rounded sums may exceed 1.
        return np.minimum(merged, 1, out=merged)


def is_merged(merged: LabelSpace, space: LabelSpace) -> bool:
    """Return whether the classes of a label space are merged classes of another."""
    return not space.fits(merged) and not contradiction(space, merged)


def contradiction(space: LabelSpace, merged: LabelSpace) -> str:
    """Return why the classes of a label space cannot be merged into another; empty if they can."""
    raw_ids = space.learning_map.keys() | space.learning_map_inv.values()
    missing = sorted(raw_ids - merged.learning_map.keys())
    if missing:
        return f"lacks raw ids {first_few([_named(space, i) for i in missing])}"
    # Ids whose names mostly differ have other meanings. Ids that represent several do not count.
    representatives = _representatives(space) | _representatives(merged)
    both = sorted((space.labels.keys() & merged.labels.keys()) - representatives)
    renamed = [i for i in both if space.labels[i] != merged.labels[i]]
    if 2 * len(renamed) > len(both):
        texts = [f"{merged.labels[i]} for raw id {_named(space, i)}" for i in renamed]
        return f"has other raw ids: {first_few(texts)}"
    scored = [i for i in range(space.class_count) if not space.ignored[i]]
    split = [i for i in scored if len(_targets(space, merged, i)) > 1]
    if split:
        names = (merged.names[k] for k in _targets(space, merged, split[0]))
        return f"splits {space.names[split[0]]} into {' and '.join(names)}"
    remaining = {_targets(space, merged, i)[0] for i in scored}
    count = len({k for k in remaining if not merged.ignored[k]})
    if count < MIN_MERGED_CLASSES and not space.fits(merged):
        few = first_few([merged.names[k] for k in sorted(remaining)])
        return f"merges all {space.class_count} classes into {few}"
    return ""


def _representatives(space: LabelSpace) -> set[int]:
    """Return the raw ids that represent train ids of several raw ids."""
    counts = Counter(space.learning_map.values())
    return {raw for train_id, raw in space.learning_map_inv.items() if counts[train_id] > 1}


def _merged_alternatives(
    space: LabelSpace, merged: LabelSpace, targets: Sequence[int]
) -> dict[int, tuple[int, ...]]:
    """Return the alternatives of a label space in merged classes; one class is no alternative."""
    alternatives = {}
    for raw, train_ids in space.alternatives.items():
        others = {targets[i] for i in train_ids if i != space.learning_map[raw]}
        ids = others | {merged.learning_map[raw]}
        if len(ids) > 1:
            alternatives[raw] = tuple(sorted(ids))
    return alternatives


def named_classes(names: Collection[str], space: LabelSpace) -> npt.NDArray[np.bool_]:
    """Return the mask (C,) of the train ids of classes, coarse classes or `MOVABLE`, by name."""
    masks: dict[str, npt.NDArray[np.bool_]] = {MOVABLE: space.movable}
    if MOVABLE in names:
        space.require_movable(f"class {MOVABLE}")
    coarse = built_in("coarse")
    if not contradiction(space, coarse):
        groups = zip(coarse.names, ClassMerging.between(space, coarse).groups, strict=True)
        masks |= {name: np.isin(np.arange(space.class_count), ids) for name, ids in groups}
    masks |= dict(zip(space.names, np.eye(space.class_count, dtype=bool), strict=True))
    unknown = [name for name in names if name not in masks]
    if unknown:
        hint = did_you_mean(unknown[0], masks)
        expected = f"one of {', '.join(masks)}"
        raise UsageError(f"class {unknown[0]}", "no such class", expected, hint)
    selected = np.zeros(space.class_count, bool)
    for name in names:
        selected |= masks[name]
    return selected


def _targets(space: LabelSpace, merged: LabelSpace, train_id: int) -> list[int]:
    """Return the merged train ids of the raw ids of a class; only one for an ignored class."""
    # An ignored class contains everything without a class, some of which the other space may have.
    representative = space.learning_map_inv[train_id]
    first = merged.learning_map[representative]
    if space.ignored[train_id]:
        return [first]
    raw_ids = {raw for raw, target in space.learning_map.items() if target == train_id}
    others = {merged.learning_map[raw] for raw in raw_ids - {representative}} - {first}
    return [first, *sorted(others)]


def _named(space: LabelSpace, raw: int) -> str:
    return f"{raw} ({space.labels[raw]})" if raw in space.labels else str(raw)
