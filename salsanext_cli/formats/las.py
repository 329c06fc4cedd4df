# SPDX-License-Identifier: MIT
"""LAS and LAZ clouds through laspy and lazrs, which are imported when they are used."""

import logging
import re
import struct
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from salsanext_cli.errors import FormatError, MissingDependency
from salsanext_cli.files.optional_packages import import_extra
from salsanext_cli.files.reading import reading, refusing_damage, size_of
from salsanext_cli.formats.columns import Columns, scan_of
from salsanext_cli.records import Scan

HEADER = struct.Struct("<4s20xBB70xII")
"""Signature, version, offset of the points, and number of the variable-length records."""
NEWEST = (1, 4)  # Newest version that laspy and lazrs read
IN_DEGREES = re.compile(
    rb"\x01\x00\x01\x00.\x00.\x00\x00\x04\x00\x00\x01\x00\x02\x00"
    rb"|\A(?!.*PROJC(?:S|RS)\[).*GEOGC(?:S|RS)\[",
    re.DOTALL,
)
"""Geographic coordinate system in the records of a file: the first key, or the text of a name."""
RECORD_BYTES = 54  # Least size of a variable-length record
MAX_POINTS_PER_BYTE = 16  # Of compressed data; a LiDAR's points take some bytes each
INTENSITY_RANGE = 65535


def read_las(path: Path, *_: object) -> Scan:
    """Read the points of a LAS or LAZ file; 16-bit intensities are divided by 65535.

    Names of columns and the intensity scale of a sensor do not apply.
    """
    columns = las_columns(path)
    intensity = columns["intensity"] / np.float32(INTENSITY_RANGE)
    used = {axis: columns[axis] for axis in "xyz"}
    return scan_of(used | {"intensity": intensity}, path, 1.0)


def las_columns(path: Path) -> Columns:
    """Read all dimensions of a LAS or LAZ file with one value per point, x, y, z in metres."""
    points = _read_points(path)
    names = {*points.point_format.dimension_names} - {"X", "Y", "Z"}
    columns = {name: np.asarray(points[name]) for name in ("x", "y", "z", *names)}
    return {name: values for name, values in columns.items() if values.ndim == 1}


def _read_points(path: Path) -> Any:
    """Return the points of a LAS or LAZ file as laspy reads them."""
    with reading(path) as file, refusing_damage(path, "a complete .las or .laz file"):
        laspy = _import_laspy(path, "laspy")
        size = size_of(file)
        # Otherwise laspy allocates the sizes in the header and reads that number of records.
        signature, major, minor, offset, record_count = HEADER.unpack(file.read(HEADER.size))
        if signature == b"LASF" and (major, minor) > NEWEST:
            hint = "convert it to LAS 1.4, for example with PDAL"
            raise FormatError(path, f"has version {major}.{minor}", "LAS 1.0 to 1.4", hint)
        if record_count * RECORD_BYTES > offset or offset > size:
            raise ValueError("its header states more data than it contains")
        if IN_DEGREES.search(file.read(offset - HEADER.size)):
            expected, hint = "metres from a sensor", "project them to metres"
            raise FormatError(path, "has coordinates in degrees", expected, hint)
        file.seek(0)
        backend = laspy.LazBackend.Lazrs
        with laspy.open(file, closefd=False, read_evlrs=False, laz_backend=backend) as reader:
            header = reader.header
            room = size // header.point_format.size
            if header.are_points_compressed:
                _import_laspy(path, "lazrs")
                room = size * MAX_POINTS_PER_BYTE
                _require_chunks(file, offset, size)
                file.seek(offset)
            if header.point_count > room:
                raise ValueError("its header states more points than it contains")
            points = reader.read_points(header.point_count)
        if len(points) != header.point_count:
            raise ValueError("it lacks points")
    return points


def _require_chunks(file: BinaryIO, offset: int, size: int) -> None:
    """Refuse a table of more chunks than a file has bytes, for which lazrs ends the process."""
    file.seek(offset)
    (table,) = struct.unpack("<q", file.read(8))
    if table == -1:  # A writer that could not seek put the offset at the end.
        file.seek(size - 8)
        (table,) = struct.unpack("<q", file.read(8))
    if not offset < table <= size - 8:
        raise ValueError("its table of chunks is outside the file")
    file.seek(table + 4)
    if struct.unpack("<I", file.read(4))[0] > size:
        raise ValueError("it states more chunks than it contains")


def _import_laspy(path: Path, package: str) -> Any:
    """Import laspy or lazrs; the error names the file that needs it."""
    logging.getLogger("laspy").addHandler(logging.NullHandler())  # Else it prints warnings
    try:
        return import_extra(package, "las")
    except MissingDependency as error:
        raise MissingDependency(path, f"needs {error.subject}", hint=error.hint) from error
