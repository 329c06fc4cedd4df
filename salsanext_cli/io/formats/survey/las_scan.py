# SPDX-License-Identifier: MIT
"""Scans of LAS and LAZ files, with intensities in the range that the files of a folder share."""

from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.errors import SalsanextError
from salsanext_cli.core.notices import notice_once
from salsanext_cli.core.records import Scan
from salsanext_cli.io.files.reading import identity
from salsanext_cli.io.formats.columns import scan_of
from salsanext_cli.io.formats.survey.las_coordinates import notice_units
from salsanext_cli.io.formats.survey.las_file import columns_of, read_las_file

BYTE = 255  # Largest intensity of sensors that write bytes
WORD = 65535  # Largest intensity, which the format asks for
SUFFIXES = (".las", ".laz")
MAX_FILES = 16  # Files of a folder that are searched for intensities above a byte
MAX_POINTS = 100_000  # Points of each of them


def read_las(
    path: Path, _: tuple[str, ...], intensity_scale: float, intensity_field: str = ""
) -> Scan:
    """Read the scan of a LAS or LAZ file; map coordinates are moved into a local frame.

    Intensities are divided by `intensity_scale` if a sensor states one, which is not 1. Otherwise
    they are divided by 65535 if one of the file or its folder is above 255, and by 255 if none is.
    """
    file = read_las_file(path)
    columns = dict(columns_of(file))
    notice_units(file.units)
    if intensity_scale == 1:
        columns["intensity"] = _share_of_range(columns["intensity"], path)
    scan = scan_of(columns, path, intensity_scale, intensity_field, may_be_map=True)
    codes = columns["classification"].astype(np.uint8)
    return replace(scan, notes=replace(scan.notes, codes=codes))


def _share_of_range(values: npt.NDArray[Any], path: Path) -> npt.NDArray[np.float32]:
    """Return intensities (N,) uint16 as shares of their range, float32."""
    largest = int(values.max(initial=0))
    divisor = WORD
    if 0 < largest <= BYTE:
        folder = path.parent
        if _has_words(folder, identity(folder)):
            notice_once(f"LAS intensities up to {BYTE} are read as 16 bits, as in their folder")
        else:
            divisor = BYTE
            notice_once(f"LAS intensities up to {BYTE} are read as bytes")
    return values.astype(np.float32) / np.float32(divisor)


@lru_cache
def _has_words(folder: Path, _: tuple[object, ...]) -> bool:
    """Return whether a LAS file of a folder has intensities above a byte.

    A single dim scan of a drive must not be brighter than the others.
    """
    visible = (path for path in folder.iterdir() if not path.name.startswith("."))
    files = sorted(path for path in visible if path.suffix.lower() in SUFFIXES)
    step = max(1, -(-len(files) // MAX_FILES))
    for file in files[::step]:
        with suppress(SalsanextError):
            start = read_las_file(file, max_points=MAX_POINTS)
            if np.asarray(start.points["intensity"]).max(initial=0) > BYTE:
                return True
    return False
