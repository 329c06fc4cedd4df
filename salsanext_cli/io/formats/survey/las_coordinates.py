# SPDX-License-Identifier: MIT
"""Coordinate system of a LAS file: units of its axes, by its records of keys or of text."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from salsanext_cli.core.errors import FormatError
from salsanext_cli.core.notices import notice_once

KEYS_RECORD = 34735  # Record of GeoTIFF keys, four uint16 each
TEXT_RECORD = 2112  # Record of the coordinate system as text (WKT)
MODEL_KEY = 1024
GEOGRAPHIC = 2  # Value of `MODEL_KEY` of longitude and latitude
GEOCENTRIC = 3  # Value of `MODEL_KEY` of an origin in the centre of the earth
SYSTEM_KEY = 3072  # Coordinate system of the map by its EPSG code
USER_DEFINED = 32767  # Value of `SYSTEM_KEY` of a system that other keys describe
LENGTH_KEY = 3076  # Unit of x and y
HEIGHT_KEY = 4099  # Unit of z
METRES_OF_CODE: Mapping[int, float] = {9001: 1.0, 9002: 0.3048, 9003: 1200 / 3937}
"""Metres per unit of length by its EPSG code: metre, foot, US survey foot."""
UTM_CODES = (*range(32601, 32661), *range(32701, 32761), *range(25828, 25839), *range(26901, 26924))
"""EPSG codes of systems in metres: UTM of WGS 84, north and south, of ETRS89 and of NAD83."""
PROJECTED_TEXT = re.compile(r"PROJC(?:S|RS)\[")
GEOCENTRIC_TEXT = re.compile(r"GEOCCS\[")
GEOGRAPHIC_TEXT = re.compile(r"GEO(?:G|D)C(?:S|RS)\[")
VERTICAL_TEXT = re.compile(r"VERT(?:_CS|CRS)\[")
UNIT_TEXT = re.compile(r'(?:LENGTH)?UNIT\["[^"]*",([0-9.eE+-]+)')
MAX_DEGREES = np.array([180.0, 90.0])
MAX_SPAN_DEG = 1.0  # Span of x and of y below which coordinates may be in degrees
FINE_SCALE = 1e-6  # Largest resolution of coordinates in degrees
EXPECTED = "metres"
CELL_DEG = 6  # Width of a zone of UTM


@dataclass(frozen=True, slots=True, kw_only=True)
class LengthUnits:
    """Metres per unit of the coordinates of a file."""

    horizontal: float = 1.0
    vertical: float = 1.0
    unknown_system: int = 0  # EPSG code of a system whose unit the file does not state; 0: none

    @property
    def are_metres(self) -> bool:
        """Whether no coordinate changes."""
        return self.horizontal == self.vertical == 1


def length_units(header: Any, path: Path) -> LengthUnits:
    """Return the units of the coordinates of a LAS file; refuse coordinates in degrees.

    A coordinate system that is only an EPSG code counts as metres.

    Parameters
    ----------
    header : laspy.LasHeader
        Header with the records of variable length.
    path : Path
        The file, for errors.

    Returns
    -------
    LengthUnits
    """
    units = LengthUnits()
    for record in header.vlrs:
        content = record.record_data_bytes()
        if record.record_id == KEYS_RECORD:
            units = _units_of_keys(content, header, path)
        elif record.record_id == TEXT_RECORD:
            return _units_of_text(content.decode("utf-8", "replace"), header, path)
    if units.are_metres:
        _require_no_span_of_degrees(header, path)
    return units


def notice_units(units: LengthUnits) -> None:
    """Print a notice about coordinates that are converted to metres, or of unknown unit, once."""
    if not units.are_metres:
        notice_once("coordinates in feet are converted to metres")
    if units.unknown_system:
        notice_once(f"EPSG:{units.unknown_system} without a unit: coordinates are read as metres")


def _units_of_keys(content: bytes, header: Any, path: Path) -> LengthUnits:
    """Return the units by a record of keys, whose first entry is its header."""
    keys = np.frombuffer(content[: len(content) // 8 * 8], "<u2").reshape(-1, 4)[1:]
    values = {int(key): int(value) for key, location, _, value in keys if location == 0}
    if values.get(MODEL_KEY) == GEOGRAPHIC:
        raise _in_degrees(header, path)
    if values.get(MODEL_KEY) == GEOCENTRIC:
        raise _geocentric(path)
    horizontal = METRES_OF_CODE.get(values.get(LENGTH_KEY, 9001), 1.0)
    vertical = METRES_OF_CODE.get(values.get(HEIGHT_KEY, 0), horizontal)
    system = values.get(SYSTEM_KEY, USER_DEFINED)
    is_unknown = LENGTH_KEY not in values and system not in (USER_DEFINED, *UTM_CODES)
    return LengthUnits(
        horizontal=horizontal, vertical=vertical, unknown_system=system if is_unknown else 0
    )


def _units_of_text(text: str, header: Any, path: Path) -> LengthUnits:
    """Return the units by a text in WKT."""
    if not PROJECTED_TEXT.search(text):
        if GEOCENTRIC_TEXT.search(text):
            raise _geocentric(path)
        if GEOGRAPHIC_TEXT.search(text):
            raise _in_degrees(header, path)
        return LengthUnits()
    match = VERTICAL_TEXT.search(text)
    end = match.start() if match else len(text)
    horizontal = _last_unit(UNIT_TEXT.findall(text[:end]), 1.0)
    vertical = _last_unit(UNIT_TEXT.findall(text[end:]), horizontal)
    return LengthUnits(horizontal=horizontal, vertical=vertical)


def _last_unit(factors: Iterable[str], default: float) -> float:
    """Return the last factor, that of the projection itself; the default without any."""
    *_, last = (default, *map(float, factors))
    return last


def _require_no_span_of_degrees(header: Any, path: Path) -> None:
    """Refuse a file whose bounds and resolution are those of degrees."""
    least = np.asarray(header.mins, np.float64)[:2]
    largest = np.asarray(header.maxs, np.float64)[:2]
    if not np.isfinite([least, largest]).all():
        return
    is_fine = max(header.scales[:2]) <= FINE_SCALE
    is_narrow = bool((largest - least < MAX_SPAN_DEG).all() and (largest > least).all())
    is_on_earth = bool((np.abs([least, largest]) <= MAX_DEGREES).all())
    # A sensor lies among its points.
    is_elsewhere = bool(((least > MAX_SPAN_DEG) | (largest < -MAX_SPAN_DEG)).any())
    if is_fine and is_narrow and is_on_earth and is_elsewhere:
        raise _in_degrees(header, path)


def _in_degrees(header: Any, path: Path) -> FormatError:
    """Return the error of coordinates in degrees, with the zone of UTM that they lie in."""
    longitude = float(header.mins[0])
    zone = int((longitude + 180) // CELL_DEG) % 60 + 1 if abs(longitude) <= 180 else 1
    code = (32700 if float(header.mins[1]) < 0 else 32600) + zone
    hint = f"project it to EPSG:{code}, in metres, with filters.reprojection of PDAL, or in QGIS"
    return FormatError(path, "has coordinates in degrees", EXPECTED, hint)


def _geocentric(path: Path) -> FormatError:
    problem = "has coordinates from the centre of the earth"
    return FormatError(path, problem, EXPECTED, "project it to a map, with PDAL or CloudCompare")
