# SPDX-License-Identifier: MIT
"""Parameters of streets, vehicles and sensors from presets/streets.toml."""

import tomllib
from collections.abc import Mapping
from importlib import resources
from types import SimpleNamespace

import numpy as np

from salsanext_cli.synthesis.mesh import Rng

_FILE = resources.files("salsanext_cli").joinpath("presets/streets.toml")
_TABLES = tomllib.loads(_FILE.read_text("utf-8"))

Numbers = SimpleNamespace  # One table as attributes; the file documents them


def weighted_choice(rng: Rng, weights: Mapping[str, float]) -> str:
    """Draw a key with a probability in proportion to its weight."""
    shares = np.array(list(weights.values()))
    return list(weights)[rng.choice(len(shares), p=shares / shares.sum())]


def _body(name: str) -> Numbers:
    """Return the shape of a vehicle; its profile is (S, 4), a row per station from the front."""
    table = _TABLES["body"][name]
    return Numbers(**table | {"profile": np.array(table["profile"])})


STYLES = tuple(Numbers(**_TABLES["style"][name]) for name in _TABLES["styles"])
"""Styles in the order of the sequences that use them."""
CARS = tuple(map(_body, _TABLES["cars"]))
BUS, CARAVAN = map(_body, ("bus", "caravan"))
TRUCKS = {
    name: Numbers(**table | {"cab": _body(table["cab"])})
    for name, table in _TABLES["truck"].items()
}
TRAFFIC: dict[str, float] = _TABLES["traffic"]
"""Relative frequencies of kinds of vehicles, parked or driving."""
BRIGHTNESS = Numbers(**_TABLES["brightness"])
HDL64 = Numbers(**_TABLES["hdl64"])
RANDOM_SENSOR = Numbers(**_TABLES["random_sensor"])
VEHICLE_OUTLINES_DEG = tuple(np.array(outline) for outline in _TABLES["outlines"])
"""Outlines of the recording vehicle, each (corners, 3): azimuth, upper edge and lower edge."""
