# SPDX-License-Identifier: MIT
"""E57 files: scans of a site with their poses, read by pye57, which is imported when it is used."""

import weakref
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from threading import Lock
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.errors import FormatError, MissingDependency, NoInputError
from salsanext_cli.core.optional_packages import import_extra
from salsanext_cli.core.poses import Poses, rotation
from salsanext_cli.core.records import Double
from salsanext_cli.io.files.reading import reading, refusing_damage, size_of
from salsanext_cli.io.formats.columns import Columns

TOPIC = "scans"
EXPECTED = "a complete .e57 file"
HINT = "copy it again"
CARTESIAN = ("cartesianX", "cartesianY", "cartesianZ")
SPHERICAL = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")
VALIDITY = ("cartesianInvalidState", "sphericalInvalidState")  # 0 of points with a measurement
INTENSITY = "intensity"
MAX_POINTS_PER_BYTE = 8  # A point takes at least one bit
MAX_LENGTH_ERROR = 1e-2  # Largest difference of the length of a quaternion from 1


class E57Header(Protocol):
    """What is read of `pye57.ScanHeader`, the node of a scan."""

    node: Any  # libe57.StructureNode
    points: Any  # libe57.CompressedVectorNode
    point_count: int
    point_fields: Sequence[str]
    rotation: Sequence[float]  # Quaternion w, x, y, z
    translation: Sequence[float]  # 3, metres

    def __getitem__(self, name: str) -> Any:
        """Return a node of the scan, such as `intensityLimits`."""

    def has_pose(self) -> bool:
        """Return whether the scan states its pose."""


class E57Recording:
    """E57 file, whose scans are those of one topic, in the frames of their sensors.

    pye57's own class of a file is not used, since it may remove a file that it cannot open.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = Lock()
        with reading(path) as file:
            self._size = size_of(file)
        if not self._size:
            raise FormatError(path, "is empty", EXPECTED, HINT)
        pye57 = _import_pye57(path)
        with _refusing_damage(path):
            self._file = pye57.libe57.ImageFile(str(path), "r")
            weakref.finalize(self, self._file.close)
            root = self._file.root()
            nodes = root["data3D"] if root.isDefined("data3D") else ()
            self._headers: list[E57Header] = [
                pye57.ScanHeader(nodes[number]) for number in range(len(nodes))
            ]

    def cloud_topics(self) -> list[str]:
        """Return the only topic, if there are scans."""
        return [TOPIC] if self._headers else []

    def without_clouds(self) -> NoInputError:
        """Return the error of a file without scans."""
        return NoInputError(self.path, "contains no scans", "an E57 file with point clouds")

    def scan_keys(self, topic: str) -> list[int]:
        """Return the numbers of the scans; `topic` is `TOPIC`."""
        return [*range(len(self._headers))]

    def point_count(self, topic: str) -> int:
        """Return the largest number of points of a scan; `topic` is `TOPIC`."""
        return max(header.point_count for header in self._headers)

    def columns(self, topic: str, key: int, number: int, path: Path) -> Columns:
        """Read a scan in the frame of its sensor, as `Bag.columns`; `key` is its number.

        Points without a measurement are NaN. Intensities above 1 are divided by their limit.
        """
        if number or not 0 <= key < len(self._headers):
            raise FormatError(path, "no such scan", "a scan that the file lists")
        header = self._headers[key]
        with self._lock, _refusing_damage(path):
            fields = _fields_of(header, path)
            if header.point_count > self._size * MAX_POINTS_PER_BYTE:
                raise ValueError("it states more points than it contains")
            values = self._values(header, fields)
            points = _cartesian(values)
            for name in VALIDITY:
                if name in values:
                    points[values[name] != 0] = np.nan
            columns: dict[str, npt.NDArray[Any]] = dict(zip("xyz", points.T, strict=True))
            if _is_single(header):  # Further digits of map coordinates are lost.
                columns = {name: column.astype(np.float32) for name, column in columns.items()}
            if INTENSITY in values:
                columns[INTENSITY] = _share_of_limits(values[INTENSITY], header)
            return columns

    def _values(self, header: E57Header, fields: list[str]) -> dict[str, Double]:
        """Read fields (N,) float64 of a scan by name."""
        libe57 = _import_pye57(self.path).libe57
        count = header.point_count
        values = {name: np.zeros(count) for name in fields}
        buffers = libe57.VectorSourceDestBuffer()
        for name, array in values.items():
            buffers.append(libe57.SourceDestBuffer(self._file, name, array, count, True, True))
        if count:
            header.points.reader(buffers).read()
        return values

    def poses(self) -> Poses | None:
        """Return the poses (N, 4, 4) of the scans in metres.

        None if a scan has none, or all are identities, which registered clouds have.
        """
        if not all(header.has_pose() for header in self._headers):
            return None
        with self._lock, _refusing_damage(self.path):
            poses = np.stack([_pose_of(header, self.path) for header in self._headers])
        return None if (poses == np.eye(4)).all() else poses


@contextmanager
def _refusing_damage(path: Path) -> Iterator[None]:
    """Turn the errors of pye57 at a damaged file into a `FormatError` of one line."""
    e57_error: type[Exception] = _import_pye57(path).libe57.E57Exception
    with refusing_damage(path, EXPECTED, HINT):
        try:
            yield
        except e57_error as error:  # Further lines are about the source text of the library.
            raise ValueError(str(error).partition("\n")[0]) from error


def _import_pye57(path: Path) -> Any:
    """Import pye57; the error names the file that needs it."""
    try:
        return import_extra("pye57", "e57")
    except MissingDependency as error:
        raise MissingDependency(path, f"needs {error.subject}", hint=error.hint) from error


def _fields_of(header: E57Header, path: Path) -> list[str]:
    """Return the fields of a scan to read; refuse a scan without coordinates."""
    present = [*header.point_fields]
    for axes in (CARTESIAN, SPHERICAL):
        if all(name in present for name in axes):
            return [*axes, *(name for name in (INTENSITY, *VALIDITY) if name in present)]
    problem = f"has fields {', '.join(present) or 'none'}"
    raise FormatError(path, problem, "cartesian or spherical coordinates")


def _cartesian(values: Mapping[str, Double]) -> Double:
    """Return coordinates (N, 3) float64 in metres; angles are in radians."""
    if CARTESIAN[0] in values:
        return np.column_stack([values[name] for name in CARTESIAN])
    distance, azimuth, elevation = (values[name] for name in SPHERICAL)
    level = distance * np.cos(elevation)
    x = level * np.cos(azimuth)
    y = level * np.sin(azimuth)
    return np.column_stack([x, y, distance * np.sin(elevation)])


def _is_single(header: E57Header) -> bool:
    """Return whether the coordinates of a scan are stored in float32."""
    libe57 = import_extra("pye57", "e57").libe57
    prototype = libe57.StructureNode(header.points.prototype())
    node = prototype.get(next(name for name in CARTESIAN + SPHERICAL if prototype.isDefined(name)))
    if node.type() != libe57.NodeType.E57_FLOAT:
        return False
    return bool(libe57.FloatNode(node).precision() == libe57.E57_SINGLE)


def _share_of_limits(values: Double, header: E57Header) -> npt.NDArray[np.float32]:
    """Return intensities (N,) float32, of 0 to 1 if the limits of the sensor are stated."""
    least = 0.0
    largest = 1.0
    if header.node.isDefined("intensityLimits"):
        limits = header["intensityLimits"]
        least = min(_number_of(limits["intensityMinimum"]), 0.0)
        largest = _number_of(limits["intensityMaximum"])
    # Limits within 0 to 1 are often those of the points.
    if largest <= 1 and least == 0:
        return values.astype(np.float32)
    return ((values - least) / max(largest - least, 1.0)).astype(np.float32)


def _number_of(node: Any) -> float:
    """Return the value of a node of a number of any type."""
    is_scaled = hasattr(node, "scaledValue")
    return float(node.scaledValue() if is_scaled else node.value())


def _pose_of(header: E57Header, path: Path) -> Poses:
    """Return the pose (4, 4) of a scan; refuse a quaternion of another length than 1."""
    w, x, y, z = map(float, header.rotation)
    length = float(np.linalg.norm([w, x, y, z]))
    translation = np.asarray(header.translation, np.float64)
    if not abs(length - 1) <= MAX_LENGTH_ERROR or not np.isfinite(translation).all():
        problem = f"has a pose with a quaternion of length {length:.3g}"
        raise FormatError(path, problem, "poses with quaternions of length 1")
    pose = np.eye(4)
    pose[:3, :3] = rotation(x / length, y / length, z / length, w / length)
    pose[:3, 3] = translation
    return pose
