# SPDX-License-Identifier: MIT
"""Coordinate system of a LAS file: units of its axes, by its records of keys or of text."""

import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.errors import FormatError
from salsanext_cli.core.notices import notice_once
from salsanext_cli.core.texts import shortened
from salsanext_cli.io.formats.survey.wkt import WktNode, read_wkt

KEYS_RECORD = 34735  # Record of GeoTIFF keys, four uint16 each
NUMBERS_RECORD = 34736  # Record of the float64 values of keys
TEXT_RECORD = 2112  # Record of the coordinate system as text (WKT)
MODEL_KEY = 1024
GEOGRAPHIC = 2  # Value of `MODEL_KEY` of longitude and latitude
GEOCENTRIC = 3  # Value of `MODEL_KEY` of an origin in the centre of the earth
SYSTEM_KEY = 3072  # Coordinate system of the map by its EPSG code
LENGTH_KEY = 3076  # Unit of x and y
LENGTH_SIZE_KEY = 3077  # Metres of a unit of x and y without a code
HEIGHT_KEY = 4099  # Unit of z
UNDEFINED = 0  # Value of a key that states nothing
USER_DEFINED = 32767  # Value of a key that other keys describe
METRE_UNIT = 9001
METRES_OF_CODE: Mapping[int, float] = {
    METRE_UNIT: 1.0,
    9002: 0.3048,
    9003: 1200 / 3937,
    9005: 0.3047972654,
    9036: 1000.0,
    9096: 0.9144,
}
"""Metres per unit of length by its EPSG code: metre, foot, US survey foot, Clarke's foot,
kilometre, yard."""
METRE_CODES = frozenset(
    {
        *range(32601, 32661),  # UTM of WGS 84, north
        *range(32701, 32761),  # UTM of WGS 84, south
        *range(25828, 25839),  # UTM of ETRS89
        *range(26901, 26924),  # UTM of NAD83
        *range(6339, 6349),  # UTM of NAD83(2011)
        *range(31965, 31986),  # UTM of SIRGAS 2000
        *range(28348, 28359),  # Australia, GDA94
        *range(7846, 7860),  # Australia, GDA2020
        *range(31466, 31470),  # Germany, Gauss-Kruger
        *range(31254, 31260),  # Austria, Gauss-Kruger
        *range(3006, 3025),  # Sweden, SWEREF99
        *range(3942, 3951),  # France, conic by degree
        *range(2176, 2181),  # Poland
        *range(2945, 2963),  # Canada, MTM and UTM of NAD83(CSRS)
        *range(2443, 2462),  # Japan, JGD2000
        *range(6669, 6688),  # Japan, JGD2011
        *range(5185, 5189),  # Korea
        2056,  # Switzerland, LV95
        21781,  # Switzerland, LV03
        2154,  # France, Lambert-93
        2193,  # New Zealand
        27700,  # Great Britain
        28992,  # Netherlands
        31370,  # Belgium
        3035,  # Europe, equal areas
        3067,  # Finland
        3763,  # Portugal
        3857,  # Web Mercator
        5514,  # Czechia and Slovakia
    }
)
"""EPSG codes of systems whose unit is the metre."""
PROJECTED_NODES = ("PROJCS", "PROJCRS", "PROJECTEDCRS", "DERIVEDPROJCRS")
LOCAL_NODES = ("LOCAL_CS", "ENGCRS", "ENGINEERINGCRS")
GEOCENTRIC_NODES = ("GEOCCS",)
GEOGRAPHIC_NODES = ("GEOGCS", "GEOGCRS", "GEOGRAPHICCRS", "GEODCRS", "GEODETICCRS")
SYSTEM_NODES = (*PROJECTED_NODES, *LOCAL_NODES, *GEOCENTRIC_NODES, *GEOGRAPHIC_NODES)
VERTICAL_NODES = ("VERT_CS", "VERTCS", "VERTCRS", "VERTICALCRS")
UNIT_NODES = ("UNIT", "LENGTHUNIT", "ANGLEUNIT")
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
    unknown_system: str = ""  # Name of a system whose unit the file does not state

    @property
    def are_metres(self) -> bool:
        """Whether no coordinate changes."""
        return self.horizontal == self.vertical == 1


def length_units(records: Mapping[int, bytes], header: Any, path: Path) -> LengthUnits:
    """Return the units of the coordinates of a LAS file; refuse degrees and unknown units.

    A text of a coordinate system without a unit counts as metres; a code counts if its system is
    known to be in metres.

    Parameters
    ----------
    records : mapping of int to bytes
        Contents of the records about the coordinate system by their numbers.
    header : laspy.LasHeader
        Header with the bounds of the points.
    path : Path
        The file, for errors.

    Returns
    -------
    LengthUnits
    """
    text = records.get(TEXT_RECORD, b"").decode("utf-8", "replace").strip("\0 \r\n")
    if text:
        units = _units_of_text(text, header, path)
        if not units.unknown_system:
            return units
    else:
        units = _units_of_keys(records, header, path) if KEYS_RECORD in records else LengthUnits()
    if units.are_metres:
        _require_no_span_of_degrees(header, path)
    return units


def notice_units(units: LengthUnits) -> None:
    """Print a notice about coordinates that are converted to metres, or of unknown unit, once."""
    if not units.are_metres:
        factors = f"x and y by {units.horizontal:.10g}, z by {units.vertical:.10g}"
        notice_once(f"coordinates are converted to metres: {factors}")
    if units.unknown_system:
        notice_once(f"{units.unknown_system} without a unit: coordinates are read as metres")


def _units_of_keys(records: Mapping[int, bytes], header: Any, path: Path) -> LengthUnits:
    """Return the units by a record of keys, whose first entry is its header."""
    keys = _whole_rows(records[KEYS_RECORD], "<u2", 4)[1:].tolist()
    values = {key: value for key, location, _, value in keys if location == 0}
    if values.get(MODEL_KEY) == GEOGRAPHIC:
        raise _in_degrees(header, path)
    if values.get(MODEL_KEY) == GEOCENTRIC:
        raise _geocentric(path)
    code = values.get(LENGTH_KEY, UNDEFINED)
    if code in METRE_CODES:  # Leica writes the code of the system there
        code = METRE_UNIT
    numbers = _whole_rows(records.get(NUMBERS_RECORD, b""), "<f8", 1).ravel()
    sizes = [
        float(numbers[index])
        for key, location, _, index in keys
        if key == LENGTH_SIZE_KEY and location == NUMBERS_RECORD and index < len(numbers)
    ]
    if code == USER_DEFINED and sizes:
        horizontal = _require_length(sizes[0], f"of {sizes[0]} m", path)
    else:
        horizontal = _metres_of_code(code, 1.0, path)
    vertical = _metres_of_code(values.get(HEIGHT_KEY, UNDEFINED), horizontal, path)
    system = values.get(SYSTEM_KEY, USER_DEFINED)
    if code == UNDEFINED and system not in {UNDEFINED, USER_DEFINED, *METRE_CODES}:
        raise _without_unit(system, path)
    return LengthUnits(horizontal=horizontal, vertical=vertical)


def _whole_rows(content: bytes, dtype: str, columns: int) -> npt.NDArray[Any]:
    """Return the table (N, C) of a record, without an incomplete row at its end."""
    size = np.dtype(dtype).itemsize * columns
    return np.frombuffer(content[: len(content) // size * size], dtype).reshape(-1, columns)


def _metres_of_code(code: int, default: float, path: Path) -> float:
    """Return the metres of a unit by its EPSG code; refuse an unknown one."""
    if code == UNDEFINED:
        return default
    if code not in METRES_OF_CODE:
        raise _unknown_unit(f"EPSG:{code}" if code != USER_DEFINED else "without a size", path)
    return METRES_OF_CODE[code]


def _units_of_text(text: str, header: Any, path: Path) -> LengthUnits:
    """Return the units by a text in WKT."""
    root = read_wkt(text)
    system = root.first(SYSTEM_NODES)
    if system is None:
        return LengthUnits(unknown_system="a coordinate system as text")
    if system.keyword in GEOCENTRIC_NODES:
        raise _geocentric(path)
    if system.keyword in GEOGRAPHIC_NODES:
        is_cartesian = any(axes.values[:1] == ["Cartesian"] for axes in system.children(["CS"]))
        raise _geocentric(path) if is_cartesian else _in_degrees(header, path)
    units = _unit_nodes(system)
    if not units:
        name = shortened(" ".join(system.values[:1]) or system.keyword)
        return LengthUnits(unknown_system=f"coordinate system {name}")
    horizontal = _metres_of_node(units[0], path)
    vertical_system = root.first(VERTICAL_NODES)
    heights = units[2:3] if vertical_system is None else _unit_nodes(vertical_system)
    vertical = _metres_of_node(heights[0], path) if heights else horizontal
    return LengthUnits(horizontal=horizontal, vertical=vertical)


def _unit_nodes(system: WktNode) -> list[WktNode]:
    """Return the unit of all axes of a system, else those of its axes."""
    common = system.children(UNIT_NODES)
    if common:
        return common[-1:]
    return [unit for axis in system.children(["AXIS"]) for unit in axis.children(UNIT_NODES)]


def _metres_of_node(unit: WktNode, path: Path) -> float:
    """Return the metres of a unit of length, such as `UNIT["metre",1]`."""
    name, *sizes = [*unit.values, ""]
    try:
        size = float(sizes[0])
    except ValueError:
        raise _unknown_unit(shortened(name), path) from None
    if unit.keyword == "ANGLEUNIT":
        raise _unknown_unit(shortened(name), path)
    return _require_length(size, shortened(name), path)


def _require_length(metres: float, name: str, path: Path) -> float:
    """Return the size of a unit; refuse one that is not a positive length."""
    if not 0 < metres < np.inf:
        raise _unknown_unit(name, path)
    return metres


def _unknown_unit(name: str, path: Path) -> FormatError:
    """Return the error of a unit whose metres are unknown."""
    hint = "project it to metres, with filters.reprojection of PDAL, or in QGIS"
    return FormatError(path, f"has coordinates in an unknown unit, {name}", EXPECTED, hint)


def _without_unit(system: int, path: Path) -> FormatError:
    """Return the error of a system by its EPSG code whose unit the file does not state."""
    problem = f"states EPSG:{system} without its unit, which may be the foot"
    options = f"--writers.las.minor_version=4 --writers.las.a_srs=EPSG:{system}"
    hint = f"add the unit: `pdal translate {shlex.quote(path.name)} NEW.las {options}`"
    return FormatError(path, problem, EXPECTED, hint)


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
