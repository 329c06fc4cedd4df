# SPDX-License-Identifier: MIT
"""Headerless little-endian files of labels, `.label`, of KITTI and nuScenes."""

from pathlib import Path

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.classes.label_space import RawIds
from salsanext_cli.core.errors import FormatError, LabelError
from salsanext_cli.core.texts import counted
from salsanext_cli.io.files.atomic import write_bytes
from salsanext_cli.io.files.reading import read_values, reading, size_of

MAX_CLASS = 0xFFFF  # Largest label of four bytes without an instance


def read_labels(path: Path, count: int | None = None) -> RawIds:
    """Read the raw ids of the points of a scan.

    Parameters
    ----------
    path : Path
        The `.label` file.
    count : int, optional
        Number of points of the scan; then labels of one or two bytes are recognised too.

    Returns
    -------
    (N,) uint32
        Class in the low 16 bits, instance in the high 16.

    Raises
    ------
    FormatError
        If the file cannot be read or is cut off.
    LabelError
        If there are not `count` labels.
    """
    with reading(path) as file:
        size = size_of(file)
        if size % 4 and (count is None or size not in (count, 2 * count)):
            expected = "a multiple of 4: one uint32 per point"
            raise FormatError(path, f"has {size} bytes", expected, "copy it again")
        raw = _labels(read_values(file, path, np.uint8, size), count or 0)
    if count is not None and len(raw) != count:
        expected = f"{count:,}, one per point of the scan"
        hint = "use the labels that belong to this scan"
        raise LabelError(path, f"has {counted(len(raw), 'label')}", expected, hint)
    return raw


def _labels(content: npt.NDArray[np.uint8], count: int) -> RawIds:
    """Return labels of two bytes or one if the size is that of `count`, else of four."""
    narrow = {2 * count: "<u2", count: "<u1"}.get(content.size)
    wide = content[: content.size // 4 * 4].view("<u4").astype(np.uint32, copy=False)
    # Classes of four bytes, without instances, of half or a quarter of the points.
    is_of_fewer = content.size % 4 == 0 and wide.any() and wide.max() <= MAX_CLASS
    if narrow is None or is_of_fewer:
        return wide
    return content.view(narrow).astype(np.uint32)


def encode_labels(raw: RawIds) -> bytes:
    """Return the content of a `.label` file: the raw id of each point as uint32."""
    return raw.astype("<u4", copy=False).tobytes()


def write_labels(path: Path, raw: RawIds) -> None:
    """Write the raw ids of the points of a scan.

    An existing file is replaced.

    Parameters
    ----------
    path : Path
        The `.label` file.
    raw : (N,) integers
        Raw ids, written as uint32.
    """
    write_bytes(path, encode_labels(raw))
