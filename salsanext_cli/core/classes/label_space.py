# SPDX-License-Identifier: MIT
"""Label spaces: classes, their names, and the mapping of raw ids to train ids.

Label files contain raw ids: uint32, the class in the low 16 bits, the instance in the high 16. The
network predicts train ids: 0…C-1, where 0 is "unlabelled".
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from typing import Any

import numpy as np
import numpy.typing as npt
import yaml

from salsanext_cli.core.classes.label_tables import (
    ALTERNATIVES,
    RAW_ID_COUNT,
    UNKNOWN,
    as_codes,
    as_colour,
    codes_of_train_ids,
    contradiction,
    entries,
    integers,
    sequence_name,
    spare_colour,
)
from salsanext_cli.core.errors import LabelError, UsageError
from salsanext_cli.core.texts import did_you_mean, first_few, percentage, shortened
from salsanext_cli.core.wording import argument, setting

TrainIds = npt.NDArray[np.uint8]
RawIds = npt.NDArray[np.uint32]

BUILT_IN = ("semantic-kitti", "coarse")
KEYS = (
    "labels",
    "learning_map",
    "learning_map_inv",
    "learning_ignore",
    "color_map",
    "split",
    ALTERNATIVES,
    "movable",
    "asprs",
)
MAX_COARSE_CLASSES = 10  # Label spaces of at most so many classes, class 0 included, are coarse
MAX_UNKNOWN_SHARE = 0.1
"""Largest tolerated share of points with unknown ids; other data sets had 0.4 or more."""
MOVING = "moving-"  # Start of the names of moving classes, which only multi-scan tasks distinguish


@dataclass(frozen=True, slots=True, eq=False)
class LabelSpace:
    """The classes of a data set.

    Attributes
    ----------
    name : str
        Name in messages and weights files.
    labels : dict of int to str
        Name of every raw id.
    learning_map : dict of int to int
        Train id of every raw id.
    learning_map_inv : dict of int to int
        Raw id that represents each train id, keys 0…C-1.
    ignored : tuple of bool, length C
        Whether training and evaluation ignore each train id.
    colours : (C, 3) uint8
        Red, green, blue of every train id.
    splits : dict of str to tuple of str
        Sequence names of every split.
    alternatives : dict of int to tuple of int
        Ambiguous raw ids: all train ids that a point may have. Only training uses them.
    movable_ids : tuple of int, optional
        Train ids of movable classes; None if the label space does not state them.
    asprs : dict of int to int, optional
        Code of the ASPRS, 0…255, of raw ids; None if the label space does not state them.
    """

    name: str
    labels: dict[int, str]
    learning_map: dict[int, int]
    learning_map_inv: dict[int, int]
    ignored: tuple[bool, ...]
    colours: npt.NDArray[np.uint8]
    splits: dict[str, tuple[str, ...]]
    alternatives: dict[int, tuple[int, ...]] = field(default_factory=dict)
    movable_ids: tuple[int, ...] | None = None
    asprs: dict[int, int] | None = None
    _train_of_raw: TrainIds = field(init=False, repr=False)

    def __post_init__(self) -> None:
        table = np.full(RAW_ID_COUNT, UNKNOWN, np.uint8)
        # `to_raw` writes this id for unlabelled points; the map may not list it.
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
        """Mask of the train ids that are not ignored, (C,) bool."""
        return ~np.array(self.ignored)

    @property
    def movable(self) -> npt.NDArray[np.bool_]:
        """Mask of the train ids of movable classes, (C,) bool.

        If the label space does not state them, they are the classes of the movable raw ids of
        SemanticKITTI, provided that most raw ids have its names; else there are none.
        """
        ids = self._movable_ids_of_kitti() if self.movable_ids is None else self.movable_ids
        return np.isin(np.arange(self.class_count), ids)

    def _movable_ids_of_kitti(self) -> tuple[int, ...]:
        """Return the train ids of SemanticKITTI's movable raw ids, if most names are its own."""
        kitti = built_in(BUILT_IN[0])
        if not self._has_names_of(kitti):
            return ()
        movable = kitti.movable_ids or ()
        raw_ids = [i for i, train_id in kitti.learning_map.items() if train_id in movable]
        return tuple(sorted({self.learning_map.get(i, 0) for i in raw_ids} - {0}))

    def _has_names_of(self, other: LabelSpace) -> bool:
        """Return whether most raw ids of both have the same name."""
        same = [self.labels[i] == other.labels[i] for i in self.labels.keys() & other.labels]
        return 2 * sum(same) > len(same)

    @property
    def asprs_codes(self) -> dict[int, int]:
        """Code of the ASPRS of each raw id, as LAS files have it.

        If the label space does not state them, they are those of its model, of raw ids with the
        same name. Without a model they are 64 + train id, which the ASPRS leaves to users.
        """
        return self._default_codes() if self.asprs is None else self.asprs

    def _default_codes(self) -> dict[int, int]:
        """Return the codes of the ASPRS of a label space that states none."""
        model = self.model()
        if model is None:
            return codes_of_train_ids(self.learning_map)
        codes = model.asprs or {}
        return {i: code for i, code in codes.items() if self.labels.get(i) == model.labels[i]}

    def model(self) -> LabelSpace | None:
        """Return the built-in label space of its name, else SemanticKITTI's; None if names differ.

        Most raw ids of both have the same name.
        """
        model = built_in(self.name if self.name in BUILT_IN else BUILT_IN[0])
        return model if self._has_names_of(model) else None

    def require_movable(self, subject: str) -> None:
        """Raise `UsageError` about a subject that needs movable classes if there are none."""
        if not self.movable.any():
            problem = f"label space {self.name} has no movable classes"
            stated = "state their train ids in its yaml file, as `movable: [1, 2]`"
            hint = f"{stated}, and predict with {setting('classes', 'FILE')}"
            raise UsageError(subject, problem, "at least one", hint)

    def unknown_ids(self, raw: RawIds) -> dict[int, int]:
        """Return the number of points by unknown raw id, without instances."""
        classes = (raw & 0xFFFF)[self._train_of_raw[raw & 0xFFFF] == UNKNOWN]
        ids, counts = np.unique(classes, return_counts=True)
        return {int(i): int(n) for i, n in zip(ids, counts, strict=True)}

    def to_train(self, raw: RawIds, *, strict: bool = True, source: object = "labels") -> TrainIds:
        """Map raw ids to train ids, without instances.

        Parameters
        ----------
        raw : uint32 array
            Raw ids, of any shape.
        strict : bool
            Whether an unknown id is an error; else it becomes 0, as in the official evaluator, and
            the caller reports `unknown_ids`.
        source : object
            Name of the labels in errors.

        Returns
        -------
        uint8 array
            Train ids, of the same shape.

        Raises
        ------
        LabelError
            If an id is unknown and `strict` is set, or if more than `MAX_UNKNOWN_SHARE` of the
            labelled points have unknown ids: these are ids of another label space.
        """
        train: TrainIds = self._train_of_raw[raw & 0xFFFF]
        unknown = train == UNKNOWN
        count = np.count_nonzero(unknown)
        if count:
            certain = count - 2 * count**0.5  # minus two standard errors of a small number
            if strict or certain > MAX_UNKNOWN_SHARE * np.count_nonzero(train):
                raise self._unknown(raw, source)
            train[unknown] = 0
        return train

    def _unknown(self, raw: RawIds, source: object) -> LabelError:
        """Return the error with the commonest unknown ids."""
        counts = self.unknown_ids(raw)
        ids = first_few([f"{i} ({counts[i]}×)" for i in sorted(counts, key=lambda i: -counts[i])])
        labelled = np.count_nonzero(self._train_of_raw[raw & 0xFFFF])
        share = percentage(sum(counts.values()) / labelled, 0)
        problem = f"has unknown label ids {ids}: {share} of the labelled points"
        hint = f"set the label space of this data with {argument('label_space')}"
        if (raw & 0xFFFF).max() < self.class_count:
            problem += f"; they are probably train ids, since none is above {self.class_count - 1}"
            hint = f"write raw ids instead of train ids, or {hint}"
        return LabelError(source, problem, f"raw ids of {self.name}", hint)

    def to_raw(self, train: npt.NDArray[Any]) -> RawIds:
        """Map train ids, integers of any shape, to their raw ids, uint32."""
        table = np.array([self.learning_map_inv[i] for i in range(self.class_count)], np.uint32)
        return table[train]

    def split(self, name: str) -> tuple[str, ...]:
        """Return the sequence names of a split; an unknown split raises `UsageError`."""
        if name not in self.splits:
            expected = f"one of {', '.join(self.splits) or 'none'}"
            hint = did_you_mean(name, self.splits)
            raise UsageError(f"split {name}", "no such split", expected, hint)
        return self.splits[name]

    def split_of(self, sequence: str) -> str | None:
        """Return the split of a sequence; None without one."""
        return next((name for name, members in self.splits.items() if sequence in members), None)

    def fits(self, other: LabelSpace) -> bool:
        """Return whether weights fit both: names and raw ids of the train ids are equal."""
        same_ids = self.learning_map_inv == other.learning_map_inv
        return same_ids and self.names == other.names

    def differences(self, other: LabelSpace) -> list[str]:
        """Return descriptions of the differences from another label space, classes first."""
        tables = self._tables()
        other_tables = other._tables()
        texts = []
        for name in dict.fromkeys([*tables, *other_tables]):
            entries = tables.get(name, {})
            other_entries = other_tables.get(name, {})
            for key in sorted(entries.keys() | other_entries.keys()):
                if entries.get(key) != other_entries.get(key):
                    values = f"{entries.get(key, 'none')} ≠ {other_entries.get(key, 'none')}"
                    texts.append(f"{name} {key}: {values}")
        return texts

    def _tables(self) -> dict[str, dict[Any, Any]]:
        """Return all that can differ between label spaces as tables by name, classes first."""
        return {
            "train id": dict(enumerate(self.names)),
            **self.to_dict(),
            "name": {"": self.name},
            "movable": dict(enumerate(self.movable.tolist())),
        }

    def to_dict(self) -> dict[str, Any]:
        """Return plain data in the form of SemanticKITTI's yaml, which `from_dict` accepts."""
        raw_ids = [self.learning_map_inv[i] for i in range(self.class_count)]
        alternatives = {i: list(train_ids) for i, train_ids in self.alternatives.items()}
        is_stated = self.movable_ids not in (None, self._movable_ids_of_kitti())
        data = {
            "name": self.name,
            "labels": self.labels,
            "color_map": dict(zip(raw_ids, self.colours[:, ::-1].tolist(), strict=True)),
            "learning_map": self.learning_map,
            "learning_map_inv": self.learning_map_inv,
            "learning_ignore": dict(enumerate(self.ignored)),
            "split": {name: list(members) for name, members in self.splits.items()},
        }
        if alternatives:
            data[ALTERNATIVES] = alternatives
        if is_stated:
            data["movable"] = list(self.movable_ids or ())
        if self.asprs not in (None, self._default_codes()):
            data["asprs"] = self.asprs
        return data

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], source: object = "label space") -> LabelSpace:
        """Build a label space from data in the form of SemanticKITTI's yaml.

        Parameters
        ----------
        data : mapping
            Tables of `KEYS`, of which only the first three are required.
        source : object
            Origin of the data in errors, and the name if the data have none.

        Returns
        -------
        LabelSpace

        Raises
        ------
        UsageError
            If the tables are of other types, or contradict each other.
        """
        try:
            labels = {int(i): str(name) for i, name in data["labels"].items()}
            learning_map = integers(data["learning_map"])
            inverse = integers(data["learning_map_inv"])
            ignored = data.get("learning_ignore", {0: True})
            ignore = {int(train): bool(flag) for train, flag in ignored.items()}
            alternatives = {
                int(i): tuple(sorted({int(train) for train in entries(train_ids)}))
                for i, train_ids in data.get(ALTERNATIVES, {}).items()
            }
            stated = data.get("movable")
            movable = None if stated is None else tuple(sorted({int(i) for i in entries(stated)}))
            asprs = as_codes(data["asprs"]) if "asprs" in data else None
            colours = {int(i): as_colour(bgr) for i, bgr in data.get("color_map", {}).items()}
            splits = {
                str(name): tuple(map(sequence_name, entries(members)))
                for name, members in data.get("split", {}).items()
            }
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            problem = f"is not a label space: {shortened(error)}"
            raise UsageError(source, problem, f"keys {', '.join(KEYS)}") from error
        problem = contradiction(labels, learning_map, inverse, alternatives, movable or ())
        if problem:
            raise UsageError(source, problem, "a consistent label space")
        ids = range(len(inverse))
        bgr = [colours.get(inverse[i], spare_colour(i)) for i in ids]
        return cls(
            name=str(data.get("name", getattr(source, "stem", source))),
            labels=labels,
            learning_map=learning_map,
            learning_map_inv=inverse,
            ignored=tuple(ignore.get(i, i == 0) for i in ids),
            colours=np.array([colour[::-1] for colour in bgr], np.uint8),
            splits=splits,
            alternatives=alternatives,
            movable_ids=movable,
            asprs=asprs,
        )


@cache
def built_in(name: str) -> LabelSpace:
    """Return a built-in label space by name, one of `BUILT_IN`."""
    file = resources.files("salsanext_cli").joinpath(f"presets/label_spaces/{name}.yaml")
    return LabelSpace.from_dict(yaml.safe_load(file.read_text("utf-8")), name)
