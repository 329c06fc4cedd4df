# SPDX-License-Identifier: MIT
"""Scans, labels and clouds written to disk, each file whole or not at all."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy.typing as npt

from salsanext_cli.classes.label_space import RawIds
from salsanext_cli.files.atomic import write_bytes
from salsanext_cli.formats.kitti import encode_bin, encode_labels
from salsanext_cli.formats.ply import encode_ply
from salsanext_cli.records import Scan


def write_bin(path: Path, scan: Scan) -> None:
    """Write a scan as float32 x, y, z, intensity."""
    write_bytes(path, encode_bin(scan))


def write_labels(path: Path, raw: RawIds) -> None:
    """Write the raw ids of a scan's points, (N,) integer, as uint32."""
    write_bytes(path, encode_labels(raw))


def write_ply(
    path: Path, columns: Mapping[str, npt.NDArray[Any]], comments: Iterable[str] = ()
) -> None:
    """Write a `.ply` file; columns and comments as `formats.ply.encode_ply` takes them."""
    write_bytes(path, encode_ply(columns, comments))
