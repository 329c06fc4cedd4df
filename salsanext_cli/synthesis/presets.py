# SPDX-License-Identifier: MIT
"""Numbers of streets, vehicles and the recording vehicle, read from presets/streets.toml."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from types import SimpleNamespace
from typing import Any

import numpy as np

from salsanext_cli.synthesis.mesh import Array, Rng

Span = tuple[float, float]

_FILE = resources.files("salsanext_cli").joinpath("presets/streets.toml")
_TABLES = tomllib.loads(_FILE.read_text("utf-8"))


@dataclass(frozen=True, slots=True)
class Style:
    """Ranges and chances that a street is drawn from; the file says what each is."""

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
    """Shape of a vehicle; the file says what each number is."""

    length: float
    width: float
    bottom: float
    wheel: float
    profile: Array  # (S, 4): a row per station from front to rear
    cabin: list[int]
    screens: list[int]


def _body(name: str) -> Body:
    table = _TABLES["body"][name]
    return Body(**table | {"profile": np.array(table["profile"])})


def weighted_choice(rng: Rng, weights: Mapping[str, float]) -> str:
    """Draw one of the keys, as often as their weights say."""
    shares = np.array(list(weights.values()))
    return list(weights)[rng.choice(len(shares), p=shares / shares.sum())]


STYLES = tuple(Style(**_TABLES["style"][name]) for name in _TABLES["styles"])
"""Styles in the order in which sequences take them; from eight on a data set has all."""
CARS = tuple(map(_body, _TABLES["cars"]))
BUS, CARAVAN = map(_body, ("bus", "caravan"))
TRUCKS: dict[str, dict[str, Any]] = _TABLES["truck"]
CABS = {kind["cab"]: _body(kind["cab"]) for kind in TRUCKS.values()}
TRAFFIC: dict[str, float] = _TABLES["traffic"]
"""Frequency of each kind of vehicle, parked or driving, relative to the others."""
BRIGHTNESS: dict[str, Any] = _TABLES["brightness"]
HDL64: dict[str, Any] = _TABLES["hdl64"]
RANDOM_SENSOR = SimpleNamespace(**_TABLES["random_sensor"])
"""Bounds and chances that random sensors are drawn from; the file says what each is."""
VEHICLE_OUTLINES_DEG = tuple(np.array(outline) for outline in _TABLES["outlines"])
"""Outlines of the recording vehicle, each (corners, 3): azimuth, upper edge and lower edge."""
