# SPDX-License-Identifier: MIT
"""LAS files with labels: the points of a scan, their classification, and further values."""

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.classes.label_space import RawIds
from salsanext_cli.core.classes.label_tables import UNASSIGNED_CODE
from salsanext_cli.core.errors import LabelError
from salsanext_cli.core.records import Scan
from salsanext_cli.io.formats import FORMATS, format_of
from salsanext_cli.io.formats.survey.las_file import import_laspy, import_lazrs, read_las_file
from salsanext_cli.io.formats.survey.las_subset import encode_las, require_no_waveforms

NEW_FORMAT = 6  # Point format of 256 classes, without colours
WITH_256_CLASSES: Mapping[int, int] = {0: 6, 1: 6, 2: 7, 3: 7, 4: 9, 5: 10}
"""Point format with 256 classes and the fields of one with 32."""
VERSION = "1.4"  # Version with these formats
RESOLUTION_M = 1e-4  # Of the coordinates of new files
MAX_NEW_DISTANCE_M = RESOLUTION_M * np.iinfo(np.int32).max
ANGLE_UNIT_DEG = 0.006  # Of angles in newer point formats; older ones have degrees
WORD = 65535  # Largest intensity
LOOKUP_RECORD = 0  # Record of the names of classes
LOOKUP_AUTHOR = "LASF_Spec"
NAME_BYTES = 15  # Of a class in it
FIRST_BYTE_OF_DATE = 90  # In the header; day and year of creation, which may be 0
BYTES_OF_DATE = 4
SOFTWARE = "salsanext"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LasLabels:
    """Labels and values of the N points of a scan for a LAS file."""

    codes: Mapping[int, int]  # Code of the ASPRS by raw id
    names: Mapping[int, str]  # Name of the class, or of the ASPRS, by code
    raw: RawIds  # (N,) uint32: raw ids without instances
    values: Mapping[str, npt.NDArray[Any]]  # (N,) by name: become extra dimensions

    @property
    def classification(self) -> npt.NDArray[np.uint8]:
        """Code of each point, (N,); `UNASSIGNED_CODE` without one."""
        ids, index = np.unique(self.raw, return_inverse=True)
        codes = [self.codes.get(raw, UNASSIGNED_CODE) for raw in ids.tolist()]
        return np.array(codes, np.uint8)[index]

    def lookup(self) -> bytes:
        """Return the record of the codes and the names of their classes, 16 bytes each."""
        # laspy reads letters, digits and blanks only.
        plain = {code: name.replace("-", " ") for code, name in self.names.items()}
        texts = [plain.get(code, "").encode("ascii", "replace") for code in range(256)]
        rows = [
            bytes([code]) + text[:NAME_BYTES].ljust(NAME_BYTES, b"\0")
            for code, text in enumerate(texts)
        ]
        return b"".join(rows)


def labelled_las(path: Path, scan: Scan, labels: LasLabels, *, compressed: bool) -> bytes:
    """Return the content of a LAS file with the labels of a scan.

    A scan in LAS keeps its points, fields and records; formats of 32 classes become the one of 256
    with the same fields. Any other scan becomes a new file, in which points without a measurement
    are withheld at the origin of its frame.

    Parameters
    ----------
    path : Path
        File of the scan.
    scan : Scan
        Its points.
    labels : LasLabels
        Labels and values of its points.
    compressed : bool
        Whether to compress the file, as LAZ.

    Returns
    -------
    bytes
    """
    laspy = import_laspy(path)
    if compressed:
        import_lazrs(path)
    is_las = format_of(path.name) is FORMATS["las"]
    cloud = _own_cloud(path, laspy) if is_las else _new_cloud(scan, laspy)
    if len(cloud.points) != len(labels.raw):
        problem = f"has {len(cloud.points):,} points, and its labels {len(labels.raw):,}"
        raise LabelError(path, problem, "one label per point", "predict again")
    present = {name for name in cloud.point_format.extra_dimension_names if name in labels.values}
    if present:
        cloud.remove_extra_dims(present)
    extra = [laspy.ExtraBytesParams(name, v.dtype) for name, v in labels.values.items()]
    cloud.add_extra_dims(extra)
    for name, values in labels.values.items():
        cloud[name] = values
    cloud.classification = labels.classification
    lookup = laspy.VLR(LOOKUP_AUTHOR, LOOKUP_RECORD, "", labels.lookup())
    records = [record for record in cloud.header.vlrs if not _is_lookup(record)]
    cloud.header.vlrs = type(cloud.header.vlrs)([*records, lookup])
    content = encode_las(cloud.header, cloud.points, path, compressed=compressed)
    return content if is_las else _without_date(content)


def _is_lookup(record: Any) -> bool:
    return (record.user_id, record.record_id) == (LOOKUP_AUTHOR, LOOKUP_RECORD)


def _own_cloud(path: Path, laspy: Any) -> Any:
    """Return the points of a LAS file in a format of 256 classes, as `laspy.LasData`."""
    file = read_las_file(path, with_extended_records=True)
    require_no_waveforms(file, path)
    cloud = laspy.LasData(copy.deepcopy(file.header), file.points)
    kind = file.header.point_format.id
    if kind not in WITH_256_CLASSES:
        return cloud
    angles = np.asarray(file.points["scan_angle_rank"], np.float64)
    cloud = laspy.convert(cloud, point_format_id=WITH_256_CLASSES[kind], file_version=VERSION)
    cloud.scan_angle = np.rint(angles / ANGLE_UNIT_DEG).astype(np.int16)
    return cloud


def _new_cloud(scan: Scan, laspy: Any) -> Any:
    """Return the points of a scan, in the coordinates of its file, as `laspy.LasData`."""
    header = laspy.LasHeader(version=VERSION, point_format=NEW_FORMAT)
    header.generating_software = SOFTWARE
    header.scales = np.full(3, RESOLUTION_M)
    header.offsets = np.array(scan.notes.frame)
    cloud = laspy.LasData(header, laspy.ScaleAwarePointRecord.zeros(len(scan), header=header))
    points = scan.points.astype(np.float64)
    with np.errstate(invalid="ignore"):
        measured = (np.abs(points) < MAX_NEW_DISTANCE_M).all(axis=1) & points.any(axis=1)
    points[~measured] = 0
    for name, values in zip("XYZ", np.rint(points / RESOLUTION_M).T, strict=True):
        cloud[name] = values.astype(np.int32)
    cloud.withheld = (~measured).astype(np.uint8)
    cloud.return_number = np.ones(len(scan), np.uint8)
    cloud.number_of_returns = np.ones(len(scan), np.uint8)
    share = np.clip(np.nan_to_num(scan.intensity, posinf=1, neginf=0), 0, 1)
    cloud.intensity = np.rint(share * np.float32(WORD)).astype(np.uint16)
    return cloud


def _without_date(content: bytes) -> bytes:
    """Return the content of a file without its day of creation, so that it depends on the scan."""
    end = FIRST_BYTE_OF_DATE + BYTES_OF_DATE
    return content[:FIRST_BYTE_OF_DATE] + bytes(BYTES_OF_DATE) + content[end:]
