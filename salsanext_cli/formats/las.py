# SPDX-License-Identifier: MIT
"""LAS and LAZ clouds through laspy and lazrs, which are imported when they are used."""

import io
import logging
import re
import struct
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes.label_space import MOVING, LabelSpace, RawIds
from salsanext_cli.errors import FormatError, MissingDependency, OutputError
from salsanext_cli.files.optional_packages import import_extra
from salsanext_cli.files.reading import reading, refusing_damage, size_of
from salsanext_cli.formats.columns import MAX_DISTANCE_M, Columns, scan_of
from salsanext_cli.records import Scan

PLACES = struct.Struct("<4s20xBB70xII")
"""Signature, version, offset of the points, and number of the records of variable length."""
NEWEST = (1, 4)  # Newest version that laspy and lazrs read
IN_DEGREES = re.compile(
    rb"\x01\x00\x01\x00.\x00.\x00\x00\x04\x00\x00\x01\x00\x02\x00"
    rb"|\A(?!.*PROJC(?:S|RS)\[).*GEOGC(?:S|RS)\[",
    re.DOTALL,
)
"""Geographic coordinate system in the records of a file: the first key, or the text of a name."""
RECORD_BYTES = 54  # Least size of a record of variable length
COMPRESSED_SUFFIX = ".laz"
MAX_POINTS_PER_BYTE = 16  # Of compressed data; a LiDAR's points take some bytes each
INTENSITY_RANGE = 65535
EXACT_INTENSITY = "scalar_intensity"
"""Extra dimension with the intensity as a float, which the standard one rounds to 16 bits."""
ORIGIN_OF_DATE, DATE_BYTES = 90, 4
FORMAT, VERSION = 7, "1.4"  # Point format with colours and 256 classes
COLOURS = ("red", "green", "blue")


def read_las(path: Path, *_: object) -> Scan:
    """Read the points of a LAS or LAZ file; 16-bit intensities are divided by 65535.

    A sensor's names of columns and its scale of the intensity do not apply.
    """
    columns = las_columns(path)
    intensity = columns.get(EXACT_INTENSITY, columns["intensity"] / np.float32(INTENSITY_RANGE))
    used = {axis: columns[axis] for axis in "xyz"}
    return scan_of(used | {"intensity": intensity}, path, 1.0)


def las_columns(path: Path) -> Columns:
    """Read all dimensions of a LAS or LAZ file with one value per point, x, y, z in metres."""
    points = read_points(path)[1]
    names = {*points.point_format.dimension_names} - {"X", "Y", "Z"}
    columns = {name: np.asarray(points[name]) for name in ("x", "y", "z", *names)}
    return {name: values for name, values in columns.items() if values.ndim == 1}


def read_points(path: Path, *, further_records: bool = False) -> tuple[Any, Any]:
    """Return the header of a LAS or LAZ file and its points, as laspy reads them."""
    with reading(path) as file, refusing_damage(path, "a whole .las or .laz file"):
        laspy = import_laspy(path, compressed=path.suffix.lower() == COMPRESSED_SUFFIX)
        size = size_of(file)
        # laspy looks for as many records as a header promises, and in memory for what is between.
        signature, major, minor, offset, record_count = PLACES.unpack(file.read(PLACES.size))
        if signature == b"LASF" and (major, minor) > NEWEST:
            hint = "convert it to LAS 1.4, with PDAL for example"
            raise FormatError(path, f"LAS {major}.{minor}", "LAS 1.0 to 1.4", hint)
        if record_count * RECORD_BYTES > offset or offset > size:
            raise ValueError("its header promises more than it holds")
        if IN_DEGREES.search(file.read(offset - PLACES.size)):
            found, expected = "coordinates in degrees, as of a map", "metres around a sensor"
            raise FormatError(path, found, expected, "project them to metres")
        file.seek(0)
        backend = laspy.LazBackend.Lazrs
        with laspy.open(
            file, closefd=False, read_evlrs=further_records, laz_backend=backend
        ) as reader:
            header = reader.header
            room = size // header.point_format.size
            if header.are_points_compressed:
                import_laspy(path, compressed=True)  # in a .las too
                room = size * MAX_POINTS_PER_BYTE
            if header.point_count > room:
                raise ValueError("its header promises more points than it holds")
            points = reader.read_points(header.point_count)
        if len(points) != header.point_count:
            raise ValueError("it lacks points")
    return header, points


def encode_las(
    path: Path,
    columns: Mapping[str, npt.NDArray[Any]],
    classification: npt.NDArray[np.uint8],
    comments: Iterable[str] = (),
) -> bytes:
    """Return a cloud as a LAS 1.4 file, compressed if its name to be ends in `.laz`.

    `columns` (N,): x, y, z in metres; red, green, blue uint8; intensity, nominally 0…1; the others
    become extra dimensions of their name and type. Points that are not finite are written at the
    origin and marked as withheld. `classification` (N,): classes of the ASPRS. Points in float64
    are of a map, which may be anywhere: the header gets an offset in their middle.
    """
    compressed = path.suffix == COMPRESSED_SUFFIX
    laspy = import_laspy(path, compressed=compressed)
    points = np.column_stack([columns[axis] for axis in "xyz"]).astype(np.float64)
    finite = np.isfinite(points).all(axis=1)
    points[~finite] = 0
    is_map = columns["x"].dtype == np.float64 and len(points) > 0
    offset = np.rint((points.min(axis=0) + points.max(axis=0)) / 2) if is_map else np.zeros(3)
    points -= offset
    farthest = float(np.abs(points).max(initial=0))
    if farthest > MAX_DISTANCE_M and not is_map:
        found = f"a point at {farthest:g} m"
        expected = f"points up to {MAX_DISTANCE_M:g} m, so that the others are not rounded"
        raise OutputError(path, found, expected, "export with --format ply")
    extra = {n: values for n, values in columns.items() if n not in ("x", "y", "z", *COLOURS)}
    extra[EXACT_INTENSITY] = extra.pop("intensity")
    header = laspy.LasHeader(version=VERSION, point_format=FORMAT)
    header.generating_software = "salsanext"
    # The finest power of two at which the farthest point fits into 32 bits.
    header.scales = np.full(3, 2.0 ** (np.frexp(farthest)[1] - 31))
    header.offsets = offset
    header.vlrs.append(laspy.VLR("LASF_Spec", 3, "salsanext", "\n".join(comments).encode()))
    header.add_extra_dims([laspy.ExtraBytesParams(n, v.dtype) for n, v in extra.items()])
    cloud = laspy.LasData(header, laspy.ScaleAwarePointRecord.zeros(len(points), header=header))
    for name, values in zip("XYZ", np.rint(points / header.scales).T, strict=True):
        cloud[name] = values.astype(np.int32)
    cloud.classification, cloud.withheld = classification, ~finite
    cloud.return_number, cloud.number_of_returns = np.ones((2, len(points)), np.uint8)
    share = np.clip(np.nan_to_num(extra[EXACT_INTENSITY], posinf=1, neginf=0), 0, 1)
    cloud.intensity = np.rint(share * INTENSITY_RANGE).astype(np.uint16)
    for name in COLOURS:
        cloud[name] = columns[name].astype(np.uint16) * 257
    for name, values in extra.items():
        cloud[name] = values
    with io.BytesIO() as buffer:
        backend = laspy.LazBackend.Lazrs if compressed else None
        cloud.write(buffer, do_compress=compressed, laz_backend=backend)
        content = bytearray(buffer.getvalue())
    # Without the day of its creation a file depends on its points only.
    content[ORIGIN_OF_DATE : ORIGIN_OF_DATE + DATE_BYTES] = bytes(DATE_BYTES)
    return bytes(content)


def import_laspy(subject: object, *, compressed: bool) -> Any:
    """Import laspy, for whose lack the error names a subject, and keep it from printing."""
    try:
        laspy = import_extra("laspy", "las")
        if compressed:
            import_extra("lazrs", "las")
    except MissingDependency as error:
        found = f"LAS needs {error.subject}"
        raise MissingDependency(subject, found, hint=error.hint) from error
    logging.getLogger("laspy").addHandler(logging.NullHandler())
    return laspy


# Classes of the ASPRS, which LAS files hold

UNASSIGNED = 1
CLASS_OF_NAME = {
    "unlabeled": UNASSIGNED,
    "unlabelled": UNASSIGNED,
    "outlier": 7,  # noise
    "ground": 2,
    "sidewalk": 2,
    "other-ground": 2,
    "terrain": 2,
    "vegetation": 5,  # high vegetation
    "trunk": 5,
    "building": 6,
    "road": 11,  # road surface
    "parking": 11,
    "lane-marking": 11,
}
"""Classes that the ASPRS has, by name of the label."""
LAST_STANDARD_CLASS = 22  # Last class that the ASPRS defines
FIRST_OWN_CLASS = 64
"""First class that the ASPRS leaves to the user: a raw id without another has this plus the id."""
LAST_OWN_CLASS = 255


def asprs_class(raw_id: int, space: LabelSpace) -> int:
    """Return the class of a raw id, `UNASSIGNED` if it is unknown or too large."""
    name = space.labels.get(raw_id, "unlabelled")
    if name in CLASS_OF_NAME:
        return CLASS_OF_NAME[name]
    still = (i for i, other in space.labels.items() if MOVING + other == name)
    own = FIRST_OWN_CLASS + next(still, raw_id)
    return own if own <= LAST_OWN_CLASS else UNASSIGNED


def classification(raw: RawIds, space: LabelSpace) -> npt.NDArray[np.uint8]:
    """Return the class of each point, (N,) uint8, for raw ids (N,) without instances."""
    ids, index = np.unique(raw, return_inverse=True)
    classes = [asprs_class(int(raw_id), space) for raw_id in ids]
    return np.array(classes, np.uint8)[index]
