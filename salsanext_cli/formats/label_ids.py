# SPDX-License-Identifier: MIT
"""Ids of labelling tools and the raw ids of a label space that they stand for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from salsanext_cli.classes.label_space import LabelSpace, RawIds
from salsanext_cli.errors import UsageError, quoted, shortened
from salsanext_cli.files.yaml_toml import read_yaml
from salsanext_cli.formats.label_scalars import NO_VALUE, Ids

CLASS_BITS = 0xFFFF
EXPECTED_MAP = "a mapping of a tool's ids to names or raw ids of the label space, such as 3: car"


@dataclass(frozen=True, slots=True)
class LabelIds:
    """Meaning of the ids of a labelling tool."""

    raw_of: dict[int, int]  # Raw id by id of the tool
    names: dict[int, str]  # Name of the class by id of the tool
    unlabelled: int  # Raw id of points without a label

    @classmethod
    def of_space(cls, space: LabelSpace, tool: Path | None = None) -> LabelIds:
        """Take the raw ids of a label space, or those that the YAML file of a tool maps to them."""
        raw_of = {i: i for i in _raw_ids(space)} if tool is None else _read_map(tool, space)
        if not space.ignored[0]:
            found = f"class 0, {space.names[0]}, counts"
            expected = "one that is ignored, for points without a label"
            raise UsageError(f"label space {space.name}", found, expected)
        names = {i: space.labels.get(raw, str(raw)) for i, raw in sorted(raw_of.items())}
        return cls(raw_of, names, space.learning_map_inv[0])

    def unknown(self, ids: Ids) -> dict[int, int]:
        """Return the number of points of each id (without instance) that has no meaning."""
        found, counts = np.unique(_classes(ids), return_counts=True)
        pairs = zip(found.tolist(), counts.tolist(), strict=True)
        return {i: n for i, n in pairs if i != NO_VALUE and i not in self.raw_of}

    def to_raw(self, ids: Ids) -> RawIds:
        """Return the raw ids (M,) of known ids; instances, the upper 16 bits, are kept."""
        found, index = np.unique(_classes(ids), return_inverse=True)
        of_class = [self.raw_of.get(i, self.unlabelled) for i in found.tolist()]
        instances = np.where(ids > 0, ids, 0) & ~CLASS_BITS
        raw: RawIds = (np.array(of_class, np.int64)[index] | instances).astype(np.uint32)
        return raw

    def described(self) -> str:
        """Return all known ids and their names in one line."""
        return ", ".join(f"{i} {name}" for i, name in self.names.items())


def _classes(ids: Ids) -> Ids:
    """Return ids without the instances in their upper 16 bits; negative ones have none."""
    return np.where(ids >= 0, ids & CLASS_BITS, ids)


def _raw_ids(space: LabelSpace) -> list[int]:
    return sorted({*space.learning_map, *space.learning_map_inv.values()})


def _read_map(path: Path, space: LabelSpace) -> dict[int, int]:
    """Read the raw id of each id of a tool; names are those of the classes, then of the raw ids."""
    try:
        data = read_yaml(path, EXPECTED_MAP)
    except FileNotFoundError as error:
        raise UsageError(f"--map {path}", "no such file", EXPECTED_MAP) from error
    if not isinstance(data, Mapping) or not data:
        raise UsageError(path, f"a {type(data).__name__}", EXPECTED_MAP)
    standing = {space.labels[raw]: raw for raw in space.learning_map_inv.values()}
    by_name = {name: raw for raw, name in reversed(space.labels.items())} | standing
    known = _raw_ids(space)
    raw_of: dict[int, int] = {}
    wrong = []
    for key, value in data.items():
        raw = by_name.get(value) if isinstance(value, str) else value
        usable = type(key) is int and key <= CLASS_BITS
        if not usable or type(raw) is not int or raw not in known:
            wrong.append(f"{quoted(key)}: {quoted(value)}")
        else:
            raw_of[key] = raw
    if wrong:
        named = ", ".join(f"{raw} {space.labels.get(raw, '')}" for raw in known)
        found = f"unknown {shortened(', '.join(wrong))}"
        raise UsageError(path, found, f"whole numbers for {named}")
    return raw_of
