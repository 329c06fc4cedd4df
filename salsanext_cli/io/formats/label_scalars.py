# SPDX-License-Identifier: MIT
"""Labels in point clouds of other programs: coordinates and the scalar with the label."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from operator import attrgetter
from pathlib import Path
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.classes.asprs import (
    HIGH_VEGETATION,
    LOWER_VEGETATION,
    UNASSIGNED_CODES,
    train_ids_of_codes,
)
from salsanext_cli.core.classes.label_space import LabelSpace, RawIds
from salsanext_cli.core.errors import FormatError, LabelError, UsageError
from salsanext_cli.core.records import Float, Mask, Origin
from salsanext_cli.core.texts import quoted, shortened
from salsanext_cli.core.wording import argument, setting
from salsanext_cli.io.files.yaml_toml import read_yaml
from salsanext_cli.io.formats import FORMATS, errors_of_plug_ins, format_of, suffixes_in_words
from salsanext_cli.io.formats.columns import Columns, coordinates_of_edited
from salsanext_cli.io.formats.field_names import PREFIX, listed
from salsanext_cli.io.formats.survey.local_frame import NO_SHIFT

LABEL_READER = attrgetter("label_columns")  # Of a format; None without one
LABEL_NAMES = (
    "label",
    "labels",
    "class",
    "classes",
    "class_id",
    "classification",
    "category",
    "semantic",
    "semantics",
    "semantic_label",
    "sem_class",
    "sem_label",
    "segmentation",
)
"""Names of label scalars, in lower case, without the prefix."""
ASPRS_SCALAR = "classification"  # Scalar of LAS, with classes of the ASPRS
ASPRS_CLASSES = range(2, 23)  # Classes that the ASPRS defines; 0 and 1 are unassigned
NO_VALUE = np.iinfo(np.int64).min  # Id of a point without a value, which programs write as NaN
MAX_ID = 0xFFFFFFFF  # Largest id of a label file, with the instance in its upper 16 bits
Ids = npt.NDArray[np.int64]
CLASS_BITS = 0xFFFF
EXPECTED_MAP = "a mapping of tool ids to names or raw ids of the label space, such as 3: car"


@dataclass(frozen=True, slots=True, kw_only=True)
class LabelledCloud:
    """Points that another program labelled, in any order."""

    points: Float  # (M, 3) float32: metres, in the frame of the scan
    ids: Ids  # (M,) int64: ids of the program; `NO_VALUE` for none
    scalar: str  # Name of the scalar in the file
    has_codes: bool = False  # Whether the ids are codes of the ASPRS

    @classmethod
    def read(cls, path: Path, scalar: str | None = None, frame: Origin = NO_SHIFT) -> Self:
        """Read coordinates and labels of a cloud.

        Parameters
        ----------
        path : Path
            The file.
        scalar : str, optional
            Scalar with the labels, by default one of `LABEL_NAMES`. The classification of a LAS
            file has codes of the ASPRS, unless it is named.
        frame : 3 floats
            Frame of the scan, in which a cloud in map coordinates is returned, in metres.

        Returns
        -------
        LabelledCloud
        """
        form = format_of(path.name)
        if form is None or form.label_columns is None:
            expected = f"a {suffixes_in_words(LABEL_READER)} file"
            raise FormatError(path, "is not a cloud with labels", expected)
        with errors_of_plug_ins(path):
            columns = form.label_columns(path)
        columns = {name: values for name, values in columns.items() if values.dtype.kind in "iuf"}
        points = coordinates_of_edited(columns, path, frame)
        name = _label_column(columns, scalar, path)
        ids = whole_numbers(columns[name], path, name)
        if scalar is None and form is FORMATS["las"] and name == ASPRS_SCALAR:
            return cls(points=points, ids=ids, scalar=name, has_codes=True)
        largest = int(ids.max(initial=0))
        if scalar is None and _plain(name) == ASPRS_SCALAR and largest in ASPRS_CLASSES:
            problem = f"has {name} up to {largest}, probably classes of the ASPRS"
            hint = f"for raw ids, or with {argument('ids')}, add {setting('scalar', name)}"
            raise LabelError(path, problem, "raw ids of the label space", hint)
        return cls(points=points, ids=ids, scalar=name)


def _label_column(columns: Columns, scalar: str | None, path: Path) -> str:
    """Return the name of the column with the labels."""
    if scalar is not None:
        alike = [name for name in columns if _plain(name) == _plain(scalar)]
        fitting = [scalar] if scalar in columns else alike
        if len(fitting) != 1:
            problem = f"has {'several scalars' if fitting else 'no scalar'} of that name"
            raise FormatError(path, f"{problem}: {listed(columns)}", f"one named {scalar}")
        return fitting[0]
    fitting = [name for name in columns if _plain(name) in LABEL_NAMES]
    # Clouds converted from LAS have a classification, all 0 if nobody labelled them.
    used = [name for name in fitting if columns[name].any()] or fitting[:1]
    if not used:
        problem = f"has no label among the scalars {listed(columns)}"
        expected = f"one named {', '.join(LABEL_NAMES)}"
        raise FormatError(path, problem, expected, f"name it with {argument('scalar')}")
    if len(used) > 1:
        used.sort(key=lambda name: _plain(name) == ASPRS_SCALAR)  # A label is more specific.
        problem = f"has several scalars that may be labels: {', '.join(used)}"
        hint = f"choose one with {argument('scalar')}, as {setting('scalar', used[0])}"
        raise LabelError(path, problem, "one", hint)
    return used[0]


def _plain(name: str) -> str:
    return name.lower().removeprefix(PREFIX)


def whole_numbers(values: npt.NDArray[Any], path: Path, name: str) -> Ids:
    """Return labels as integers.

    Parameters
    ----------
    values : (M,) array
        Labels of any real dtype.
    path : Path
        The file, in errors.
    name : str
        Name of the scalar, in errors.

    Returns
    -------
    (M,) int64
        Ids; `NO_VALUE` for NaN.

    Raises
    ------
    LabelError
        If a label is no whole number, or too large.
    """
    has_value = ~np.isnan(values)
    is_broken = has_value & (values != np.rint(values))
    if is_broken.any():
        raise LabelError(path, _wrong_values(values, is_broken, name), "a whole number")
    largest = _largest_exact(values.dtype)
    is_beyond = has_value & ~((values >= -largest) & (values <= largest))
    if is_beyond.any():
        expected = f"a number up to {largest}"
        hint = ""
        if largest < MAX_ID:
            expected += f", since {values.dtype.itemsize * 8}-bit floats round larger ones"
            hint = "export integers, or classes without instances"
        raise LabelError(path, _wrong_values(values, is_beyond, name), expected, hint)
    ids = np.full(len(values), NO_VALUE, np.int64)
    ids[has_value] = values[has_value].astype(np.int64)
    return ids


def _largest_exact(dtype: np.dtype[Any]) -> int:
    """Return the largest id that a dtype holds, at most `MAX_ID`, with all smaller ones."""
    if dtype.kind != "f":
        return MAX_ID
    exact: int = 2 ** (np.finfo(dtype).nmant + 1)
    return min(exact, MAX_ID)


def _wrong_values(values: npt.NDArray[Any], is_wrong: Mask, name: str) -> str:
    """Return the first wrong value of a scalar and the number of further ones in words."""
    first = int(is_wrong.argmax())
    count = int(is_wrong.sum())
    others = f", and {count - 1:,} more" if count > 1 else ""
    return f"has {name} {values[first]} at point {first}{others}"


@dataclass(frozen=True, slots=True)
class LabelIds:
    """Meaning of the ids of a labelling tool."""

    raw_of: dict[int, int]  # Raw id by id of the tool
    names: dict[int, str]  # Name of the class by id of the tool
    unlabelled: int  # Raw id of points without a label
    codes: LabelIds | None = None  # Meaning of codes of the ASPRS, if it is another one
    is_stated: bool = False  # Whether the user stated it in a file

    @classmethod
    def from_space(cls, space: LabelSpace, tool: Path | None = None) -> LabelIds:
        """Return the raw ids of a label space, or of the map in the YAML file of a tool.

        The codes of the ASPRS mean what the label space states, unless there is such a map.
        """
        raw_of = {i: i for i in _raw_ids(space)} if tool is None else _read_map(tool, space)
        _require_class_of_unlabelled(space)
        names = {i: space.labels.get(raw, str(raw)) for i, raw in sorted(raw_of.items())}
        unlabelled = space.learning_map_inv[0]
        if tool is not None:
            return cls(raw_of, names, unlabelled, is_stated=True)
        return cls(raw_of, names, unlabelled, cls.from_codes(space))

    @classmethod
    def from_train_ids(cls, space: LabelSpace) -> LabelIds:
        """Return the raw ids of the train ids of a label space."""
        _require_class_of_unlabelled(space)
        names = dict(enumerate(space.names))
        return cls(dict(space.learning_map_inv), names, space.learning_map_inv[0])

    @classmethod
    def from_names(cls, names: Mapping[int, str], space: LabelSpace, source: Path) -> LabelIds:
        """Return the raw ids of ids whose classes a file of a tool names."""
        _require_class_of_unlabelled(space)
        raw_ids = raw_ids_of_names(names.values(), space, source)
        raw_of = {i: raw_ids[name] for i, name in names.items()}
        return cls(raw_of, dict(sorted(names.items())), space.learning_map_inv[0])

    def with_unlabelled(self, ids: Ids) -> LabelIds:
        """Return the same meanings, with further ids that mean no label."""
        others = dict.fromkeys(np.unique(_classes(ids)).tolist(), self.unlabelled)
        return replace(self, raw_of=others | self.raw_of)

    @classmethod
    def from_codes(cls, space: LabelSpace) -> LabelIds:
        """Return the raw ids of the codes of the ASPRS but those of several classes."""
        _require_class_of_unlabelled(space)
        classes = train_ids_of_codes(space)
        unlabelled = space.learning_map_inv[0]
        raw_of = dict.fromkeys(UNASSIGNED_CODES, unlabelled)
        for code, train_ids in classes.items():
            raw_of.pop(code, None)
            if len(train_ids) <= 1:
                raw_of[code] = space.learning_map_inv[min(train_ids, default=0)]
        if HIGH_VEGETATION in raw_of:
            lower = [code for code in LOWER_VEGETATION if code not in classes]
            raw_of |= dict.fromkeys(lower, raw_of[HIGH_VEGETATION])
        names = {code: space.labels[raw] for code, raw in sorted(raw_of.items())}
        return cls(raw_of, names, unlabelled)

    def for_cloud(self, cloud: LabelledCloud) -> LabelIds:
        """Return the meaning of the ids of a cloud."""
        return self.codes if self.codes is not None and cloud.has_codes else self

    def unknown(self, ids: Ids) -> dict[int, int]:
        """Return the number of points of each id (without instance) that has no meaning."""
        unique, counts = np.unique(_classes(ids), return_counts=True)
        pairs = zip(unique.tolist(), counts.tolist(), strict=True)
        return {i: n for i, n in pairs if i != NO_VALUE and i not in self.raw_of}

    def to_raw(self, ids: Ids) -> RawIds:
        """Return the raw ids (M,) of known ids, with their instances in the upper 16 bits."""
        unique, index = np.unique(_classes(ids), return_inverse=True)
        raw_ids = [self.raw_of.get(i, self.unlabelled) for i in unique.tolist()]
        instances = np.where(ids > 0, ids, 0) & ~CLASS_BITS
        return (np.array(raw_ids, np.int64)[index] | instances).astype(np.uint32)

    def described(self) -> str:
        """Return all known ids and their names on one line."""
        return ", ".join(f"{i} {name}" for i, name in self.names.items())


def _require_class_of_unlabelled(space: LabelSpace) -> None:
    """Refuse a label space without a class for points without a label."""
    if not space.ignored[0]:
        expected = "an ignored class 0, for points without a label"
        problem = f"counts class 0, {space.names[0]}"
        raise UsageError(f"label space {space.name}", problem, expected)


def _classes(ids: Ids) -> Ids:
    """Return ids without the instances in their upper 16 bits; negative ids have none."""
    return np.where(ids >= 0, ids & CLASS_BITS, ids)


def raw_ids_of_names(names: Iterable[str], space: LabelSpace, source: Path) -> dict[str, int]:
    """Return the raw id of each name of a class in a file; refuse names of no class."""
    raw_ids = _raw_ids_by_name(space)
    names = list(names)
    unknown = sorted({name for name in names if name not in raw_ids})
    if unknown:
        problem = f"has unknown classes {shortened(', '.join(unknown))}"
        hint = "rename them in the labelling tool, or change labels.yaml"
        raise LabelError(source, problem, f"classes of {space.name}: {', '.join(raw_ids)}", hint)
    return {name: raw_ids[name] for name in names}


def _raw_ids_by_name(space: LabelSpace) -> dict[str, int]:
    """Return the raw id of each name; of several, the one that represents its class."""
    by_name = {name: raw for raw, name in reversed(space.labels.items())}
    return by_name | {space.labels[raw]: raw for raw in space.learning_map_inv.values()}


def _raw_ids(space: LabelSpace) -> list[int]:
    return sorted({*space.learning_map, *space.learning_map_inv.values()})


def _read_map(path: Path, space: LabelSpace) -> dict[int, int]:
    """Read the raw id of each id of a tool, from raw ids or names of classes."""
    try:
        data = read_yaml(path, EXPECTED_MAP)
    except FileNotFoundError as error:
        subject = f"{argument('ids')} {path}"
        raise UsageError(subject, "no such file", EXPECTED_MAP) from error
    if not isinstance(data, Mapping) or not data:
        raise UsageError(path, f"contains a {type(data).__name__}", EXPECTED_MAP)
    by_name = _raw_ids_by_name(space)
    raw_ids = _raw_ids(space)
    raw_of: dict[Any, Any] = {
        key: by_name.get(value) if isinstance(value, str) else value for key, value in data.items()
    }
    wrong = [
        f"{quoted(key)}: {quoted(data[key])}"
        for key, raw in raw_of.items()
        if type(key) is not int or key > CLASS_BITS or type(raw) is not int or raw not in raw_ids
    ]
    if wrong:
        named = ", ".join(f"{raw} {space.labels.get(raw, '')}" for raw in raw_ids)
        problem = f"has unknown entries {shortened(', '.join(wrong))}"
        raise UsageError(path, problem, f"whole numbers for {named}")
    return raw_of
