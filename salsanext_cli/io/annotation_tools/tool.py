# SPDX-License-Identifier: MIT
"""Interface of a labelling tool: the files that it opens, and the files that it saves."""

import json
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.classes.label_space import LabelSpace, RawIds
from salsanext_cli.core.errors import FormatError
from salsanext_cli.core.plain_data import Json
from salsanext_cli.core.poses import Poses
from salsanext_cli.core.records import Origin, Scan
from salsanext_cli.io.files.reading import reading, refusing_damage
from salsanext_cli.io.formats.label_scalars import Ids, LabelIds, LabelledCloud
from salsanext_cli.io.formats.pcd import read_header

Files = Mapping[str, bytes]  # Content of files by path in the folder of a tool, with slashes


@dataclass(frozen=True, slots=True, kw_only=True)
class LabelledPoints:
    """A scan with the labels to correct."""

    sequence: str
    stem: str  # Of the file of the scan
    scan: Scan  # N points
    labels: RawIds  # (N,) uint32: raw ids
    # Position of the sensor in metres, in the frame of the points, if they are registered to a map
    origin: Origin | None = None

    def columns(self) -> dict[str, npt.NDArray[Any]]:
        """Return coordinates in metres and intensity, (N,) float32 each, as tools name them."""
        coordinates = dict(zip("xyz", self.scan.points.T, strict=True))
        return {**coordinates, "intensity": self.scan.intensity}


@dataclass(frozen=True, slots=True, kw_only=True)
class ToolLabels:
    """Labels of one scan from a file of a tool."""

    cloud: LabelledCloud  # Of M points
    meanings: LabelIds  # Of the ids in the cloud
    is_in_order: bool  # Whether the points are those of the scan, in their order
    doubt: str = ""  # Why the meanings may be wrong, in words


class AnnotationTool(ABC):
    """A tool to label scans with."""

    name: ClassVar[str]  # On the command line, and of its folder in a data set
    saves: ClassVar[str]  # What it saves, in messages
    edits_in_place: ClassVar[bool] = False  # Whether it saves into the files that it got

    def place_of(self, sequence: str, stem: str) -> str:
        """Return the path of the files of a scan in the folder of the tool, without a suffix.

        Its words name the scan. Two scans may have one place, such as `08_1_5`.
        """
        return f"{sequence}_{stem}"

    @abstractmethod
    def scan_files(self, scan: LabelledPoints, space: LabelSpace) -> Files:
        """Return the files of a scan with labels of a label space."""

    def sequence_files(self, sequence: str, stems: Sequence[str], poses: Poses | None) -> Files:
        """Return further files of a sequence of N scans, which are sorted.

        `poses` are (N, 4, 4) float64 from the frame of a scan to that of the drive, in metres, or
        None if they are unknown.
        """
        return {}

    def common_files(self, space: LabelSpace) -> Files:
        """Return further files of all scans, such as the classes of a label space."""
        return {}

    @abstractmethod
    def recognises(self, path: Path) -> bool:
        """Return whether the tool saved a file with labels, or got it."""

    def is_sure_of(self, path: Path) -> bool:
        """Return whether a file that the tool recognises can be of no other program."""
        return True

    def lacks_labels(self, path: Path) -> bool:
        """Return whether a point cloud is of the tool, which has the labels in another file."""
        return False

    @abstractmethod
    def read(self, path: Path, scan: Scan, space: LabelSpace) -> ToolLabels:
        """Read a file that the tool recognises, of a scan whose labels are of a label space."""


def named_raw_ids(space: LabelSpace) -> dict[int, str]:
    """Return the name of every raw id of a label space but that of points without a label."""
    raw_ids = {*space.learning_map, *space.learning_map_inv.values()}
    raw_ids.discard(space.learning_map_inv[0])
    return {raw: space.labels[raw] for raw in sorted(raw_ids & space.labels.keys())}


def whole_numbers_of_json(values: Sequence[int]) -> Ids:
    """Return a list of JSON as an array (N,) int64; raise `ValueError` for other values."""
    numbers = np.array(values)
    if len(values) and (numbers.dtype.kind != "i" or numbers.ndim != 1):
        raise ValueError("a list of other values than whole numbers")
    return numbers.astype(np.int64)


def read_json_object(path: Path, expected: str) -> Json:
    """Read a JSON object; `expected` is what the file should contain, in errors."""
    with reading(path) as file, refusing_damage(path, expected):
        return Json(json.load(file).items())


def mentions(path: Path, word: str) -> bool:
    """Return whether a file contains a word of ASCII; not if it cannot be read."""
    try:
        with reading(path) as file:
            return word.encode("ascii") in file.read()
    except FormatError:
        return False


def pcd_fields(path: Path) -> tuple[str, ...]:
    """Return the names of the fields of a PCD file; none of other and of damaged files."""
    if path.suffix.lower() != ".pcd":
        return ()
    try:
        with reading(path) as file:
            return read_header(file, path).names
    except FormatError:
        return ()
