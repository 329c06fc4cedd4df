# SPDX-License-Identifier: MIT
"""Names of the fields of scans as programs write them: prefixes, units, synonyms."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Self

from salsanext_cli.core.errors import FormatError
from salsanext_cli.core.notices import notice_once
from salsanext_cli.core.texts import shortened
from salsanext_cli.core.wording import argument, setting

AXES = ("x", "y", "z")
AXIS_STYLES = (
    ("x", "y", "z"),
    ("x1", "y1", "z1"),
    ("pos_x", "pos_y", "pos_z"),
    ("position_x", "position_y", "position_z"),
    ("point_x", "point_y", "point_z"),
    ("x_coordinate", "y_coordinate", "z_coordinate"),
    ("points:0", "points:1", "points:2"),
    ("points_m_xyz:0", "points_m_xyz:1", "points_m_xyz:2"),
)
"""Plain names of the three axes, in order of precedence; the last two are of VeloView, ParaView."""
INTENSITY_NAMES = ("intensity", "reflectivity", "reflectance", "remission", "intensities", "i")
"""Plain names of the intensity, in order of precedence."""
METRES = {
    **dict.fromkeys(("", "-", "m", "metre", "metres", "meter", "meters"), 1.0),
    **dict.fromkeys(("mm", "millimetre", "millimetres", "millimeter", "millimeters"), 1e-3),
    **dict.fromkeys(("cm", "centimetre", "centimetres", "centimeter", "centimeters"), 1e-2),
    **dict.fromkeys(("ft", "feet", "foot"), 0.3048),
    "dm": 0.1,
    "km": 1e3,
}
"""Metres per unit of length, as it is written behind the name of an axis."""
UNIT = re.compile(r"(.*?)\s*[(\[]([^)\]]*)[)\]]")
UNIT_OF_AXIS = re.compile(r"([xyz]1?)_(m|mm|cm|dm|km|ft)")
PREFIX = "scalar_"  # Start of the names of scalars in files of CloudCompare
MAX_SHOWN_CHARACTERS = 300
MAX_NAME_CHARACTERS = 200  # Longest name that is taken apart


@dataclass(frozen=True, slots=True)
class FieldName:
    """Name of a field, taken apart."""

    plain: str  # In lower case, without prefix and unit
    unit: str  # In lower case; empty without one
    group: str = ""  # In lower case, what stands before the last point, as in ``velocity.x``

    @classmethod
    def parsed(cls, name: str) -> Self:
        """Take a name apart, such as ``X1 (mm)``, ``scalar_Intensity`` or ``attr.reflectance``."""
        plain = name.strip(" \t\"'").lower()
        unit = ""
        if len(plain) > MAX_NAME_CHARACTERS:
            return cls(plain, unit)
        match = UNIT.fullmatch(plain) or UNIT_OF_AXIS.fullmatch(plain)
        if match:
            plain = match[1]
            unit = match[2].strip()
        group, _, last = plain.rpartition(".")
        if last:
            plain = last
        return cls("_".join(plain.removeprefix(PREFIX).split()), unit, group)


@dataclass(frozen=True, slots=True)
class AxisFields:
    """Names of the fields with the coordinates."""

    names: tuple[str, ...]  # Of x, y, z
    metres: tuple[float, ...]  # Metres per unit of each

    @classmethod
    def among(cls, names: Sequence[str], path: object) -> Self:
        """Find the coordinates among the names of a file."""
        by_group = _axes_by_group(names)
        if not by_group:
            plain = _by_plain_name(names)
            missing = [axis for axis in AXES if axis not in plain] or ["x, y, z of one prefix"]
            raise FormatError(path, f"has columns {listed(names)}", f"also {', '.join(missing)}")
        axes = by_group.get("") or next(iter(by_group.values()))
        if "" not in by_group and len(by_group) > 1:
            problem = f"has coordinates of several prefixes: {listed(by_group)}"
            raise FormatError(path, problem, "one", f"rename {', '.join(axes)} to x, y, z")
        if tuple(FieldName.parsed(name).plain for name in axes) != AXES:
            notice_once(f"columns {', '.join(axes)} are read as x, y, z")
        return cls(axes, tuple(_metres(name, path) for name in axes))


def _metres(name: str, path: object) -> float:
    unit = FieldName.parsed(name).unit
    if unit not in METRES:
        problem = f"has {shortened(name)}, of an unknown unit"
        raise FormatError(path, problem, "coordinates in m, cm, mm or ft", "convert them to metres")
    if METRES[unit] != 1:
        notice_once(f"coordinates in {unit} are converted to metres")
    return METRES[unit]


def has_axes(names: Sequence[str]) -> bool:
    """Return whether names contain those of x, y and z."""
    return bool(_axes_by_group(names))


def has_bare_axes(names: Sequence[str]) -> bool:
    """Return whether names contain those of x, y and z without anything before a point."""
    return "" in _axes_by_group(names)


def _axes_by_group(names: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Return the names of the coordinates by their group; the empty group has none."""
    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault(FieldName.parsed(name).group, []).append(name)
    axes = {group: _axes_of(members) for group, members in groups.items()}
    return {group: names_of_axes for group, names_of_axes in axes.items() if names_of_axes}


def _axes_of(names: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the coordinates in the first style that is complete; empty for none."""
    plain = _by_plain_name(names)
    for style in AXIS_STYLES:
        if all(name in plain for name in style):
            return tuple(plain[name] for name in style)
    return ()


def intensity_among(names: Sequence[str], requested: str, path: object) -> str | None:
    """Return the name of the intensity.

    Parameters
    ----------
    names : sequence of str
        Names of the fields of a file.
    requested : str
        Requested name; empty for a usual one.
    path : object
        The file, for errors.

    Returns
    -------
    str or None
        None if no name was requested and none is usual.

    Raises
    ------
    FormatError
        If no single field has the requested name.
    """
    if not requested:
        bare = _by_plain_name(name for name in names if not FieldName.parsed(name).group)
        # A name without a group takes precedence, whichever of the usual ones it is.
        fields = [
            plain.get(name) for plain in (bare, _by_plain_name(names)) for name in INTENSITY_NAMES
        ]
        return next(filter(None, fields), None)
    # The exact name takes precedence over one that differs in case, prefix or unit.
    for same in (str, str.lower, lambda name: FieldName.parsed(name).plain):
        fitting = [name for name in names if same(name) == same(requested)]
        if len(fitting) == 1:
            return fitting[0]
    problem = f"has no single field {shortened(requested)}"
    others = fields_beside(names)
    hint = f"omit {argument('intensity_field')}"
    if others:
        hint = f"for example {setting('intensity_field', others[0])}"
    raise FormatError(path, problem, f"one of {listed(others)}", hint)


def fields_beside(names: Iterable[str]) -> tuple[str, ...]:
    """Return the names of the fields that are no coordinates."""
    axes = set(chain.from_iterable(AXIS_STYLES))
    return tuple(name for name in names if name and FieldName.parsed(name).plain not in axes)


def listed(names: Iterable[str]) -> str:
    """Return the names of fields for an error."""
    return shortened(", ".join(names) or "nothing", MAX_SHOWN_CHARACTERS)


def _by_plain_name(names: Iterable[str]) -> dict[str, str]:
    """Return names by their plain ones.

    Of several, the plain one itself takes precedence, then one without a prefix, then the first.
    """
    plain: dict[str, str] = {}
    for name in sorted(names, key=_difference):
        plain.setdefault(FieldName.parsed(name).plain, name)
    return plain


def _difference(name: str) -> int:
    """Return how much a name differs from its plain one, for sorting."""
    parsed = FieldName.parsed(name)
    if name == parsed.plain:
        return 0
    if parsed.group:
        return 3
    return 2 if name.lower().startswith(PREFIX) else 1
