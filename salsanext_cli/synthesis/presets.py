# SPDX-License-Identifier: MIT
"""Parameters of simulated streets: raw ids, materials and their optics, and two files of tables.

The tables are `presets/streets.toml` and `presets/surfaces.toml`. The optics of a 905 nm laser
pulse reproduce the spread of the intensity of every class in scans of an HDL-64E.
"""

import tomllib
from collections.abc import Mapping
from enum import IntEnum
from importlib import resources
from types import SimpleNamespace
from typing import Any, Self

import numpy as np


def _tables(name: str) -> dict[str, Any]:
    """Return the tables of a file of the presets."""
    file = resources.files("salsanext_cli").joinpath(f"presets/{name}.toml")
    return tomllib.loads(file.read_text("utf-8"))


_TABLES = _tables("streets")
_SURFACES = _tables("surfaces")

Numbers = SimpleNamespace  # One table as attributes; the file documents them

CAR = 10
BICYCLE = 11
BUS = 13
MOTORCYCLE = 15
ON_RAILS = 16
TRUCK = 18
OTHER_VEHICLE = 20
PERSON = 30
BICYCLIST = 31
MOTORCYCLIST = 32
ROAD = 40
PARKING = 44
SIDEWALK = 48
OTHER_GROUND = 49
MARKING = 60
TERRAIN = 72
BUILDING = 50
FENCE = 51
STRUCTURE = 52
VEGETATION = 70
TRUNK = 71
POLE = 80
SIGN = 81
CLUTTER = 99

MOVING = {
    CAR: 252, BICYCLIST: 253, PERSON: 254, MOTORCYCLIST: 255, ON_RAILS: 256, BUS: 257,
    TRUCK: 258, OTHER_VEHICLE: 259,
}  # fmt: skip
"""Raw ids of classes in motion."""


class Material(IntEnum):
    """Material of a surface, numbered from 0, and its optics."""

    # Brightness: intensity of a surface facing the sensor at 15 m. Texture: relative spread of the
    # brightness from point to point. Falloff: exponent of the cosine of incidence, near grazing.
    # Gloss: share of the pulses that a dark mirror reflects away from the sensor. Roughness:
    # standard deviation of the surface along the ray, metres.
    optics: tuple[float, ...]

    def __new__(cls, *optics: float) -> Self:
        """Give a material its number and its optics."""
        member = int.__new__(cls, len(cls.__members__))
        member._value_, member.optics = int(member), optics
        return member

    ASPHALT = 0.39, 0.14, 1.2, 0.0, 0.004
    PAVING = 0.43, 0.09, 0.8, 0.0, 0.004
    GRASS = 0.43, 0.16, 0.4, 0.0, 0.016
    MARKING = 0.5, 0.15, 0.7, 0.0, 0.004
    PLASTER = 0.47, 0.16, 0.3, 0.0, 0.0
    BRICK = 0.43, 0.14, 0.3, 0.0, 0.004
    GLASS = 0.06, 0.8, 0.5, 1.0, 0.0
    LEAF = 0.47, 0.22, 0.25, 0.0, 0.015
    FOLIAGE = 0.47, 0.22, 0.25, 0.0, 0.06
    BARK = 0.45, 0.2, 0.3, 0.0, 0.006
    WOOD = 0.43, 0.16, 0.3, 0.0, 0.004
    METAL = 0.32, 0.35, 0.5, 0.1, 0.0
    PAINT = 0.34, 0.35, 0.9, 0.12, 0.0
    RUBBER = 0.04, 0.5, 0.4, 0.15, 0.0
    CLOTH = 0.52, 0.2, 0.3, 0.0, 0.012
    SKIN = 0.5, 0.12, 0.3, 0.0, 0.005
    RETRO = 0.95, 0.1, 0.2, 0.0, 0.0
    LAMP = 0.6, 0.5, 0.3, 0.2, 0.0
    SOIL = 0.38, 0.14, 0.6, 0.0, 0.012
    GRAVEL = 0.41, 0.18, 0.5, 0.0, 0.012
    HIGH_GRASS = 0.43, 0.2, 0.3, 0.0, 0.04


OPTICS = np.array([material.optics for material in Material])
"""Optics of all materials, (materials, 5)."""
TUFTED = np.isin(np.arange(len(Material)), (Material.GRASS, Material.HIGH_GRASS))
"""Whether a material has tufts, which make it the rougher the farther apart pulses hit it."""


def weighted_choice(rng: np.random.Generator, weights: Mapping[str, float]) -> str:
    """Draw a key with a probability in proportion to its weight."""
    shares = np.array(list(weights.values()))
    return list(weights)[rng.choice(len(shares), p=shares / shares.sum())]


def _body(name: str) -> Numbers:
    """Return the shape of a vehicle; its profile is (S, 4), a row per station from the front."""
    table = _TABLES["body"][name]
    return Numbers(**table | {"profile": np.array(table["profile"])})


def _style(name: str, mix: str) -> Numbers:
    """Return a style: its table of the streets and of the surfaces, lots of both, and a mix."""
    street = _TABLES["style"][name]
    surfaces = _SURFACES["style"][name]
    objects = _TABLES["mix"][mix]
    both = {
        "lots": street["lots"] | surfaces["lots"],
        "crowd": street["crowd"] * objects["crowd"],
        "traffic": street["traffic"] * objects["traffic"],
        "parked": max(street["parked"], objects["parked"]),
    }
    return Numbers(**street | surfaces | objects | both)


STYLES = tuple(_style(name, "ordinary") for name in _TABLES["styles"])
"""Styles of ordinary streets."""
BALANCED_STYLES = tuple(_style(name, "balanced") for name in _TABLES["styles"])
"""Styles of streets where objects of rare classes are frequent."""


def is_balanced(sequence: int) -> bool:
    """Return whether objects of rare classes are frequent in a sequence: in every other one."""
    round_number, place = divmod(sequence, len(STYLES))
    return (round_number + place) % 2 == 1


def style_of(sequence: int) -> Numbers:
    """Return the style of a sequence; two rounds have each style with either mix."""
    styles = BALANCED_STYLES if is_balanced(sequence) else STYLES
    return styles[sequence % len(styles)]


CARS = tuple(map(_body, _TABLES["cars"]))
BUS_BODY, MINIBUS_BODY, CARAVAN_BODY = map(_body, ("bus", "minibus", "caravan"))
TRUCKS = {
    name: Numbers(**table | {"cab": _body(table["cab"])})
    for name, table in _TABLES["truck"].items()
}
BRIGHTNESS = Numbers(**_TABLES["brightness"] | _SURFACES["brightness"])
HDL64 = Numbers(**_TABLES["hdl64"])
RANDOM_SENSOR = Numbers(**_TABLES["random_sensor"])
VEHICLE_OUTLINES_DEG = tuple(np.array(outline) for outline in _TABLES["outlines"])
"""Outlines of the recording vehicle, each (corners, 3): azimuth, upper edge and lower edge."""
