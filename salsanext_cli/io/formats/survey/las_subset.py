# SPDX-License-Identifier: MIT
"""LAS files with some of their points: header, records, order and values stay as they are."""

import copy
import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from salsanext_cli.core.errors import FormatError
from salsanext_cli.core.records import Mask
from salsanext_cli.io.formats.subsets import masked
from salsanext_cli.io.formats.survey.las_file import LasFile, import_laspy, read_las_file

RECORDS_OF_ORDER = ("copc", "LAStools", "laszip encoded")
"""Authors of records about the order or the compression of the points of a file."""


def las_subset(path: Path, _: tuple[str, ...]) -> Callable[[Mask], bytes]:
    """Read a LAS or LAZ file; the files of some points are compressed as it is."""
    file = read_las_file(path, with_extended_records=True)
    require_no_waveforms(file, path)

    def subset(mask: Mask) -> bytes:
        indices = masked(np.arange(len(file.points)), mask, path)
        points = file.points[indices]
        return encode_las(file.header, points, path, compressed=file.compressed)

    return subset


def require_no_waveforms(file: LasFile, path: Path) -> None:
    """Refuse a file with waveforms behind its points, which laspy does not write again."""
    if file.header.global_encoding.waveform_data_packets_internal:
        problem = "contains waveforms, which are not written"
        hint = "move them into a .wdp file, or remove them with PDAL"
        raise FormatError(path, problem, "points without waveforms in the file", hint)


def encode_las(header: Any, points: Any, path: Path, *, compressed: bool) -> bytes:
    """Return the content of a LAS file.

    Parameters
    ----------
    header : laspy.LasHeader
        Header; numbers and bounds of the points are updated in a copy.
    points : laspy.ScaleAwarePointRecord
        Points in the format of the header.
    path : Path
        The file, for errors.
    compressed : bool
        Whether to compress the points, as in LAZ.

    Returns
    -------
    bytes
    """
    laspy = import_laspy(path)
    header = copy.deepcopy(header)
    header.vlrs = _other_records(header.vlrs)
    if header.evlrs is not None:
        header.evlrs = _other_records(header.evlrs)
    cloud = laspy.LasData(header, points)
    backend = laspy.LazBackend.Lazrs if compressed else None
    with io.BytesIO() as buffer:
        cloud.write(buffer, do_compress=compressed, laz_backend=backend)
        return buffer.getvalue()


def _other_records(records: Any) -> Any:
    """Return the records of variable length but those of `RECORDS_OF_ORDER`."""
    return type(records)(r for r in records if r.user_id not in RECORDS_OF_ORDER)
