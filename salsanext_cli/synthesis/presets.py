# SPDX-License-Identifier: MIT
"""Numbers of streets, vehicles and the recording vehicle, read from presets/streets.toml."""

import tomllib
from dataclasses import dataclass
from importlib import resources
from typing import Any

import numpy as np

from salsanext_cli.synthesis.mesh import Array

Span = tuple[float, float]

_FILE = resources.files("salsanext_cli").joinpath("presets/streets.toml")
_TABLES = tomllib.loads(_FILE.read_text("utf-8"))


@dataclass(frozen=True, slots=True)
class Style:
    """Ranges and chances that a street is drawn from; the file says what each is."""

    name: str
    lane: Span
    wide: float
    parking: float
    verge: float
    gravel: float
    sidewalk: float
    sidewalk_width: Span
    flush: float
    bank: float
    lots: dict[str, float]
    setback: Span
    lot_width: Span
    tree_gap: Span
    parked: float
    crossing_gap: Span
    crowd: float
    traffic: float
    barrier: bool = False


@dataclass(frozen=True, slots=True)
class Body:
    """Shape of a vehicle; the file says what each number is.

    ``profile`` is (S, 4): a row per station from front to rear.
    """

    length: float
    width: float
    bottom: float
    wheel: float
    profile: Array
    cabin: list[int]
    screens: list[int]


@dataclass(frozen=True, slots=True)
class RandomSensor:
    """Bounds and chances that random sensors are drawn from; the file says what each is."""

    beam_counts: list[int]
    column_counts: list[int]
    max_rays: int
    upper_edge: Span
    lower_edge: Span
    elevation_jitter: float
    dense_chance: float
    dense_elevation: Span
    dense_width: Span
    dense_factor: Span
    lost_beams_chance: float
    lost_beams: Span
    stagger: list[float]
    laser_aside: Span
    mount: Span
    tilt: float
    shadows: list[str]
    roof_edge: Span
    roof_ahead_and_behind: Span
    roof_ahead: Span
    noise: Span
    nearest: Span
    farthest: Span
    lost_pulses: Span
    threshold: Span
    gain: Span
    gamma: Span
    intensity_steps: list[int]


def _body(name: str) -> Body:
    table = _TABLES["body"][name]
    return Body(**table | {"profile": np.array(table["profile"])})


STYLES = tuple(Style(name, **_TABLES["style"][name]) for name in _TABLES["styles"])
"""Styles in the order in which sequences take them; from eight on a data set has all."""
CARS = tuple(map(_body, _TABLES["cars"]))
BUS, CARAVAN = map(_body, ("bus", "caravan"))
TRUCKS: dict[str, dict[str, Any]] = _TABLES["truck"]
CABS = {kind["cab"]: _body(kind["cab"]) for kind in TRUCKS.values()}
TRAFFIC: dict[str, float] = _TABLES["traffic"]
"""Frequency of each kind of vehicle, parked or driving, relative to the others."""
BRIGHTNESS: dict[str, Any] = _TABLES["brightness"]
RANDOM_SENSOR = RandomSensor(**_TABLES["random_sensor"])
VEHICLE_OUTLINES_DEG = tuple(np.array(outline) for outline in _TABLES["outlines"])
"""Outlines of the recording vehicle, each (corners, 3): azimuth, upper edge and lower edge."""
