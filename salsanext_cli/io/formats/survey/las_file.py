# SPDX-License-Identifier: MIT
"""LAS and LAZ files through laspy and lazrs, which are imported when they are used."""

import logging
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.errors import FormatError, MissingDependency
from salsanext_cli.core.optional_packages import import_extra
from salsanext_cli.core.records import Double
from salsanext_cli.io.files.reading import reading, refusing_damage, size_of
from salsanext_cli.io.formats.columns import Columns
from salsanext_cli.io.formats.field_names import AXES
from salsanext_cli.io.formats.survey.las_chunks import require_chunk_sizes
from salsanext_cli.io.formats.survey.las_coordinates import LengthUnits, length_units
from salsanext_cli.io.formats.survey.las_records import projection_records

HEADER = struct.Struct("<4s20xBB68xHIIBH")
"""Signature, version, size of the header, offset of the points, number of records of variable
length, point format with bits of compression, and bytes of a point."""
SIGNATURE = b"LASF"
NEWEST_VERSION = (1, 4)  # Newest version that laspy and lazrs read
LAST_POINT_FORMAT = 10
POINT_FORMAT_BITS = 0x3F  # The others mark compressed points
RECORD_BYTES = 54  # Least size of a record of variable length
MAX_POINTS_PER_BYTE = 16  # Of compressed points; those of a LiDAR take some bytes each
EXPECTED = "a complete .las or .laz file"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LasFile:
    """Header and points of a LAS file, as laspy reads them."""

    header: Any  # laspy.LasHeader
    points: Any  # laspy.ScaleAwarePointRecord of N points
    units: LengthUnits
    compressed: bool

    def coordinates(self) -> Double:
        """Return x, y, z (N, 3) float64 in metres; NaN of withheld points."""
        metres = (self.units.horizontal, self.units.horizontal, self.units.vertical)
        axes = zip("xyz", metres, strict=True)
        # Damaged scales may be any numbers.
        with np.errstate(over="ignore", invalid="ignore"):
            points = np.column_stack([np.asarray(self.points[name]) * unit for name, unit in axes])
        points[np.asarray(self.points["withheld"], bool)] = np.nan
        return points


def las_columns(path: Path) -> Columns:
    """Read all dimensions of a LAS or LAZ file with one value per point, x, y, z in metres."""
    return columns_of(read_las_file(path))


def read_classification(path: Path) -> npt.NDArray[np.uint8]:
    """Read the classification (N,) of the points of a LAS or LAZ file, codes of the ASPRS."""
    file = read_las_file(path, only_classification=True)
    return np.array(file.points["classification"], np.uint8)


def columns_of(file: LasFile) -> Columns:
    """Return all dimensions (N,) of a file with one value per point, x, y, z in metres."""
    names = [n for n in file.points.point_format.dimension_names if n.lower() not in AXES]
    columns = {name: np.asarray(file.points[name]) for name in names}
    columns = {name: values for name, values in columns.items() if values.ndim == 1}
    return dict(zip("xyz", file.coordinates().T, strict=True)) | columns


def read_las_file(
    path: Path,
    *,
    with_extended_records: bool = False,
    max_points: int | None = None,
    only_classification: bool = False,
) -> LasFile:
    """Read a LAS or LAZ file.

    Parameters
    ----------
    path : Path
        The file.
    with_extended_records : bool
        Whether to read the records behind the points, too, to write them again.
    max_points : int, optional
        Largest number of points to read, from the first; by default all.
    only_classification : bool
        Whether other fields may be zero, which takes half the time in compressed files.

    Returns
    -------
    LasFile

    Raises
    ------
    FormatError
        If it is damaged, of another version or point format, or in degrees.
    MissingDependency
        If laspy is missing, or lazrs and the points are compressed.
    """
    with reading(path) as file, refusing_damage(path, EXPECTED):
        laspy = import_laspy(path)
        size = size_of(file)
        offset = _require_readable(file, path, size)
        file.seek(0)
        backend = laspy.LazBackend.Lazrs
        fields = laspy.DecompressionSelection.all()
        if only_classification:
            fields = laspy.DecompressionSelection.CLASSIFICATION
        with laspy.open(
            file,
            closefd=False,
            read_evlrs=False,
            laz_backend=backend,
            decompression_selection=fields,
        ) as reader:
            header = reader.header
            units = length_units(projection_records(file, header, size), header, path)
            is_compressed = bool(header.are_points_compressed)
            room = size // header.point_format.size
            if is_compressed:
                import_lazrs(path)
                room = size * MAX_POINTS_PER_BYTE
                if header.point_count:
                    require_chunk_sizes(file, header, size)
            file.seek(offset)
            if header.point_count > room:
                raise ValueError("its header states more points than it contains")
            count = min(header.point_count, max_points or header.point_count)
            points = reader.read_points(count)
            if len(points) != count:
                raise ValueError("it lacks points")
            if with_extended_records and header.number_of_evlrs:
                reader.read_evlrs()
    return LasFile(header=header, points=points, units=units, compressed=is_compressed)


def _require_readable(file: BinaryIO, path: Path, size: int) -> int:
    """Refuse a header that laspy cannot read or trusts too much; return the offset of the points.

    laspy allocates the sizes in the header and reads that number of records.
    """
    content = file.read(HEADER.size)
    if not content:
        raise FormatError(path, "is empty", EXPECTED, "copy it again")
    if content[: len(SIGNATURE)] != SIGNATURE:
        raise FormatError(path, "is not a LAS file", EXPECTED)
    signature_to_points = HEADER.unpack(content)
    _, major, minor, header_size, offset, record_count, kind, _ = signature_to_points
    if (major, minor) > NEWEST_VERSION:
        problem = f"has version {major}.{minor}"
        hint = "convert it to LAS 1.4, for example with PDAL"
        raise FormatError(path, problem, "LAS 1.0 to 1.4", hint)
    point_format = kind & POINT_FORMAT_BITS
    if point_format > LAST_POINT_FORMAT:
        problem = f"has point format {point_format}"
        expected = f"a point format from 0 to {LAST_POINT_FORMAT}"
        raise FormatError(path, problem, expected, "convert it, for example with PDAL")
    if header_size + record_count * RECORD_BYTES > offset or offset > size:
        raise ValueError("its header states more data than it contains")
    return int(offset)


def import_laspy(path: Path) -> Any:
    """Import laspy; the error names the file that needs it."""
    logging.getLogger("laspy").addHandler(logging.NullHandler())  # Else it prints warnings
    return _import_for(path, "laspy")


def import_lazrs(path: Path) -> Any:
    """Import lazrs, which compresses; the error names the file that needs it."""
    return _import_for(path, "lazrs")


def _import_for(path: Path, package: str) -> Any:
    try:
        return import_extra(package, "las")
    except MissingDependency as error:
        raise MissingDependency(path, f"needs {error.subject}", hint=error.hint) from error
