# SPDX-License-Identifier: MIT
"""Labels in point clouds of other programs: coordinates and the scalar that holds the label."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.errors import FormatError, LabelError, shortened
from salsanext_cli.formats.clouds.asprs import LAST_STANDARD_CLASS, UNASSIGNED
from salsanext_cli.formats.clouds.las import las_columns
from salsanext_cli.formats.clouds.pcd import pcd_columns
from salsanext_cli.formats.clouds.ply import ply_columns
from salsanext_cli.formats.columns import Columns
from salsanext_cli.records import Float

READERS: dict[str, Callable[[Path], Columns]] = {
    ".ply": ply_columns,
    ".pcd": pcd_columns,
    ".las": las_columns,
    ".laz": las_columns,
}
"""Readers of all columns of a cloud by the suffix of its file, in lower case."""
LABEL_NAMES = (
    *("label", "labels", "class", "classes", "class_id", "classification", "category"),
    *("semantic", "semantics", "semantic_label", "sem_class", "sem_label", "segmentation"),
)
"""Names of scalars that hold labels, in lower case, without the prefix."""
OF_ASPRS = "classification"
"""Name of the scalar that holds classes of the ASPRS in LAS files, whoever made them."""
PREFIX = "scalar_"
"""Start of the names of scalars in what CloudCompare writes."""
NO_VALUE = np.iinfo(np.int64).min
"""Id of a point without a value, for which programs write NaN."""
MAX_ID = 0xFFFFFFFF
"""Largest number that a label file holds, the instance in its upper 16 bits."""
MAX_SHOWN_CHARACTERS = 300

Ids = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class LabelledCloud:
    """Points that another program labelled, in any order."""

    points: Float  # (M, 3) float32: metres, in the frame of the scan
    ids: Ids  # (M,) int64: ids of the program; `NO_VALUE` where it has none
    scalar: str  # Name of the scalar in the file


def read_labelled_cloud(path: Path, scalar: str | None = None) -> LabelledCloud:
    """Read coordinates and labels of a PLY, PCD, LAS or LAZ file.

    `path`: the file, with a suffix of `READERS`; `scalar`: name of the scalar with the labels;
    otherwise the only one of the `LABEL_NAMES`.
    """
    columns = READERS[path.suffix.lower()](path)
    columns = {name: values for name, values in columns.items() if values.dtype.kind in "iuf"}
    by_axis = {name.lower(): values for name, values in columns.items() if name.lower() in "xyz"}
    if missing := [axis for axis in "xyz" if axis not in by_axis]:
        raise FormatError(path, f"points of {_listed(columns)}", f"also {', '.join(missing)}")
    name = _label_column(columns, scalar, path)
    # float64 beyond float32 becomes infinity, and a NaN may signal; neither is a measurement.
    with np.errstate(over="ignore", invalid="ignore"):
        points = np.column_stack([by_axis[axis].astype(np.float32) for axis in "xyz"])
    ids = whole_numbers(columns[name], path, name)
    if scalar is None and _plain(name) == OF_ASPRS:
        _require_own_classes(ids, path, name)
    return LabelledCloud(points, ids, name)


def _label_column(columns: Columns, scalar: str | None, path: Path) -> str:
    """Return the name of the column that holds the labels."""
    if scalar is not None:
        fitting = [name for name in columns if name == scalar] or [
            name for name in columns if _plain(name) == _plain(scalar)
        ]
        if len(fitting) != 1:
            found = f"{'several scalars' if fitting else 'no scalar'} of that name"
            raise FormatError(path, f"{found}: {_listed(columns)}", f"one called {scalar}")
        return fitting[0]
    fitting = [name for name in columns if _plain(name) in LABEL_NAMES]
    # LAS has a classification, whoever labels; where nobody did, all of it is 0.
    used = [name for name in fitting if columns[name].any()] or fitting[:1]
    if not used:
        raise FormatError(
            path,
            f"no label among the scalars {_listed(columns)}",
            f"one called {', '.join(LABEL_NAMES)}",
            "name it with --scalar",
        )
    if len(used) > 1:
        found = f"several scalars that may be labels: {', '.join(used)}"
        raise LabelError(path, found, "one", f"choose with --scalar, as --scalar {used[0]}")
    return used[0]


def _require_own_classes(ids: Ids, path: Path, name: str) -> None:
    """Refuse a classification whose ids may all be classes of the ASPRS."""
    largest = int(ids.max(initial=0))
    if UNASSIGNED < largest <= LAST_STANDARD_CLASS:
        found = f"{name} up to {largest}, which may be classes of the ASPRS"
        remedy = f"for raw ids, or with --map, give --scalar {name}"
        raise LabelError(path, found, "raw ids of the label space", remedy)


def _plain(name: str) -> str:
    return name.lower().removeprefix(PREFIX)


def _listed(columns: Columns) -> str:
    return shortened(", ".join(columns) or "nothing", MAX_SHOWN_CHARACTERS)


def whole_numbers(values: npt.NDArray[Any], path: Path, name: str) -> Ids:
    """Return labels (M,) of any real dtype as integers, `NO_VALUE` for NaN."""
    known = ~np.isnan(values) if values.dtype.kind == "f" else np.ones(len(values), bool)
    most = MAX_ID
    if values.dtype.kind == "f":
        most = min(MAX_ID, 2 ** (np.finfo(values.dtype).nmant + 1))
        whole = values == np.rint(values)
        _require(whole | ~known, values, path, name, "a whole number")
    possible = (values >= -most) & (values <= most)
    expected = f"a number up to {most}"
    remedy = ""
    if most < MAX_ID:
        expected += f", since {values.dtype.itemsize * 8}-bit floats round larger ones"
        remedy = "export integers, or classes without instances"
    _require(possible | ~known, values, path, name, expected, remedy)
    ids = np.full(len(values), NO_VALUE, np.int64)
    ids[known] = values[known].astype(np.int64)
    return ids


def _require(
    sound: npt.NDArray[np.bool_],
    values: npt.NDArray[Any],
    path: Path,
    name: str,
    expected: str,
    remedy: str = "",
) -> None:
    if not sound.all():
        first = int(np.argmin(sound))
        count = len(sound) - int(sound.sum())
        found = f"{name} of point {first} is {values[first]}"
        found += f", and so are {count - 1:,} more" if count > 1 else ""
        raise LabelError(path, found, expected, remedy)
