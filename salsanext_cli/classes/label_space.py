# SPDX-License-Identifier: MIT
"""Label spaces: classes, their names, and the mapping of raw ids to train ids.

Label files hold raw ids (uint32, the low 16 bits are the class, the high 16 the instance). The
network predicts train ids: 0…C-1, 0 being "unlabelled".
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import yaml

from salsanext_cli.classes.label_yaml import ALTERNATIVES, KEYS, RAW_ID_COUNT, UNKNOWN, read_fields
from salsanext_cli.errors import LabelError, UsageError, first_few
from salsanext_cli.files.yaml_toml import read_yaml

TrainIds = npt.NDArray[np.uint8]
RawIds = npt.NDArray[np.uint32]

BUILT_IN = ("semantic-kitti", "coarse")
MAX_UNKNOWN_SHARE = 0.1
"""Largest share of the labelled points of a scan whose ids may be unknown where that is tolerated,
beyond twice the standard error of a small number; of another data set it was 0.4 or more."""
MOVING = "moving-"
"""Start of the names of moving things, which are classes of their own over several scans only."""


@dataclass(frozen=True, slots=True, eq=False)
class LabelSpace:
    """The classes of a data set.

    Attributes
    ----------
    name : str
        Name in messages and weights.
    labels : dict of int to str
        Name of every raw id.
    learning_map : dict of int to int
        Train id of every raw id.
    learning_map_inv : dict of int to int
        The raw id that stands for each train id, keys 0…C-1.
    ignored : tuple of bool, length C
        Train ids that neither training nor evaluation counts.
    colours : (C, 3) uint8
        Red, green, blue of every train id.
    splits : dict of str to tuple of str
        Sequence names of every split.
    alternatives : dict of int to tuple of int
        Raw ids that do not tell some classes apart: all train ids that a point of each may have.
        Only training takes them into account.
    """

    name: str
    labels: dict[int, str]
    learning_map: dict[int, int]
    learning_map_inv: dict[int, int]
    ignored: tuple[bool, ...]
    colours: npt.NDArray[np.uint8]
    splits: dict[str, tuple[str, ...]]
    alternatives: dict[int, tuple[int, ...]] = field(default_factory=dict)
    _train_of_raw: TrainIds = field(init=False, repr=False)

    def __post_init__(self) -> None:
        table = np.full(RAW_ID_COUNT, UNKNOWN, np.uint8)
        # What `to_raw` writes for unlabelled points is known, also where the map does not list it.
        table[self.learning_map_inv[0]] = 0
        table[list(self.learning_map)] = list(self.learning_map.values())
        object.__setattr__(self, "_train_of_raw", table)

    @property
    def class_count(self) -> int:
        """C, the number of train ids including 0."""
        return len(self.learning_map_inv)

    @property
    def names(self) -> tuple[str, ...]:
        """Name of every train id."""
        return tuple(self.labels[self.learning_map_inv[i]] for i in range(self.class_count))

    @property
    def scored(self) -> npt.NDArray[np.bool_]:
        """Mask of the train ids that count, (C,) bool."""
        return ~np.array(self.ignored)

    def unknown_ids(self, raw: RawIds) -> dict[int, int]:
        """Return the number of points of each raw id (without instance) that is unknown here."""
        classes = (raw & 0xFFFF)[self._train_of_raw[raw & 0xFFFF] == UNKNOWN]
        ids, counts = np.unique(classes, return_counts=True)
        return {int(i): int(n) for i, n in zip(ids, counts, strict=True)}

    def to_train(self, raw: RawIds, *, strict: bool = True, source: object = "labels") -> TrainIds:
        """Map raw ids to train ids; instance bits are dropped.

        Parameters
        ----------
        raw : uint32, any shape
            Raw ids as label files hold them.
        strict : bool
            Raise on an unknown id; otherwise it becomes 0, unlabelled, as in the official
            evaluator, and the caller reports `unknown_ids`. More than `MAX_UNKNOWN_SHARE` of the
            labelled points are never tolerated: these are ids of something else.
        source : object
            Subject of the error.

        Returns
        -------
        uint8, same shape

        Raises
        ------
        LabelError
            If `strict` and an id is unknown, or too many are.
        """
        train: TrainIds = self._train_of_raw[raw & 0xFFFF]
        unknown = train == UNKNOWN
        if count := np.count_nonzero(unknown):
            certain = count - 2 * count**0.5
            if strict or certain > MAX_UNKNOWN_SHARE * np.count_nonzero(train):
                raise self._unknown(raw, source)
            train[unknown] = 0
        return train

    def _unknown(self, raw: RawIds, source: object) -> LabelError:
        """Return the error that names the commonest unknown ids, and what they look like."""
        counts = self.unknown_ids(raw)
        ids = first_few([f"{i} ({counts[i]}×)" for i in sorted(counts, key=lambda i: -counts[i])])
        of_labelled = sum(counts.values()) / np.count_nonzero(self._train_of_raw[raw & 0xFFFF])
        found = f"unknown label ids {ids}: {100 * of_labelled:.0f} % of the labelled points"
        remedy = "give the label space of this data with --label-space"
        if (raw & 0xFFFF).max() < self.class_count:
            found += f", and no id above {self.class_count - 1}: train ids?"
            remedy = f"write raw ids in place of train ids, or {remedy}"
        return LabelError(source, found, f"raw ids of {self.name}", remedy)

    def to_raw(self, train: npt.NDArray[Any]) -> RawIds:
        """Map train ids to the raw ids that stand for them, uint32."""
        table = np.array([self.learning_map_inv[i] for i in range(self.class_count)], np.uint32)
        raw: RawIds = table[train]
        return raw

    def split(self, name: str) -> tuple[str, ...]:
        """Return the sequence names of a split; an unknown split raises `UsageError`."""
        if name not in self.splits:
            raise UsageError(
                f"split {name}", "no such split", f"one of {', '.join(self.splits) or 'none'}"
            )
        return self.splits[name]

    def split_of(self, sequence: str) -> str | None:
        """Return the split of a sequence, None without one."""
        return next((name for name, members in self.splits.items() if sequence in members), None)

    def fits(self, other: LabelSpace) -> bool:
        """Return whether both have the same names and raw ids of the same train ids.

        Then weights for one serve the other; splits and ignored classes may differ.
        """
        same_ids = self.learning_map_inv == other.learning_map_inv
        return same_ids and self.names == other.names

    def differences(self, other: LabelSpace) -> list[str]:
        """Name what another label space has otherwise, the classes first."""
        pairs = zip_longest(self._described(), other._described(), fillvalue="none")
        found = [f"train id {i}: {a} ≠ {b}" for i, (a, b) in enumerate(pairs) if a != b]
        for key in ("learning_map", "splits", "labels", "alternatives"):
            mine, theirs = getattr(self, key), getattr(other, key)
            changed = [k for k in mine.keys() | theirs if mine.get(k) != theirs.get(k)]
            words = {
                "learning_map": "train id of raw id",
                "splits": "split",
                "labels": "raw id",
                "alternatives": "alternatives of raw id",
            }
            found += [
                f"{words[key]} {k}: {_words(mine.get(k))} ≠ {_words(theirs.get(k))}"
                for k in sorted(changed)
            ]
        if self.colours.tolist() != other.colours.tolist():
            found.append("colours")
        if self.name != other.name:
            found.append(f"name: {self.name} ≠ {other.name}")
        return found

    def _described(self) -> list[str]:
        named = zip(self.names, self.learning_map_inv.values(), self.ignored, strict=True)
        return [f"{name} ({raw}{', ignored' * ignored})" for name, raw, ignored in named]

    def to_dict(self) -> dict[str, Any]:
        """Return plain data in the form of SemanticKITTI's yaml, which `from_dict` accepts."""
        return {
            "name": self.name,
            "labels": self.labels,
            "color_map": {
                self.learning_map_inv[i]: self.colours[i, ::-1].tolist()
                for i in range(self.class_count)
            },
            "learning_map": self.learning_map,
            "learning_map_inv": self.learning_map_inv,
            "learning_ignore": dict(enumerate(self.ignored)),
            "split": {name: list(members) for name, members in self.splits.items()},
        } | (
            {ALTERNATIVES: {i: list(several) for i, several in self.alternatives.items()}}
            if self.alternatives
            else {}
        )

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], source: object = "label space") -> LabelSpace:
        """Build a label space from data in the form of SemanticKITTI's yaml.

        Raises
        ------
        UsageError
            If the data is not of that form or contradicts itself; `source` is named.
        """
        return cls(**read_fields(data, source))


def _words(value: object) -> str:
    listed = value if isinstance(value, tuple) else (value,)
    return "none" if value is None else " ".join(map(str, listed))


@cache
def _built_in(name: str) -> LabelSpace:
    file = resources.files("salsanext_cli").joinpath(f"presets/label_spaces/{name}.yaml")
    return LabelSpace.from_dict(yaml.safe_load(file.read_text("utf-8")), name)


def label_space(name_or_file: str | Path = "semantic-kitti") -> LabelSpace:
    """Return a built-in label space by name, or read one from a SemanticKITTI-style yaml.

    Raises
    ------
    UsageError
        If there is no such name or file, or the file is not of that form.
    """
    if str(name_or_file) in BUILT_IN:
        return _built_in(str(name_or_file))
    path = Path(name_or_file)
    try:
        data = read_yaml(path, "a yaml file in SemanticKITTI's form")
    except FileNotFoundError as error:
        raise UsageError(
            path, "no such file", f"a .yaml file or one of {', '.join(BUILT_IN)}"
        ) from error
    if not isinstance(data, dict):
        raise UsageError(
            path, f"a {type(data).__name__}", f"a mapping with the keys {', '.join(KEYS)}"
        )
    return LabelSpace.from_dict(data, path)
