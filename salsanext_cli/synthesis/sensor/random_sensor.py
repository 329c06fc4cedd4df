# SPDX-License-Identifier: MIT
"""Random sensors, as different as the products that there are: beams, mounting, response."""

import numpy as np
import numpy.typing as npt

from salsanext_cli.synthesis.mesh import Array, Rng
from salsanext_cli.synthesis.presets import RANDOM_SENSOR
from salsanext_cli.synthesis.sensor.beams import Beams
from salsanext_cli.synthesis.sensor.hdl64 import lasers
from salsanext_cli.synthesis.sensor.lidar import Response
from salsanext_cli.synthesis.sensor.shadow import hidden_by_vehicle


def random_beams(rng: Rng) -> Beams:
    """Draw the lasers of a sensor: their number, elevations, firings and deviations."""
    lost = rng.uniform(*RANDOM_SENSOR["lost_beams"]) * (rng.random() < 0.3)
    elevation = random_elevations(rng)
    elevation = elevation[rng.random(len(elevation)) >= lost]
    count = len(elevation)
    most = int(RANDOM_SENSOR["rays"] / count)
    columns = min(int(rng.choice(RANDOM_SENSOR["columns"])), most)
    stagger = rng.choice([0.0, 1.0]) * rng.uniform(0, 2 * np.pi / columns, count)
    aside = rng.uniform(*RANDOM_SENSOR["aside"]) * np.resize([1.0, -1.0], count)
    level = np.zeros(count)
    return Beams(np.radians(elevation), stagger, level, aside, *lasers(rng, count), columns)


def random_elevations(rng: Rng) -> Array:
    """Draw elevations in degrees, the highest first: evenly spaced, or denser at the horizon."""
    count = int(rng.choice(RANDOM_SENSOR["beams"]))
    up, down = rng.uniform(*RANDOM_SENSOR["up"]), rng.uniform(*RANDOM_SENSOR["down"])
    even = np.linspace(up, down, 1001)
    dense = 0.0
    if rng.random() < RANDOM_SENSOR["uneven"]:
        middle, width = rng.uniform(*RANDOM_SENSOR["middle"]), rng.uniform(*RANDOM_SENSOR["width"])
        dense = rng.uniform(*RANDOM_SENSOR["denser"]) * np.exp(
            -(((even - middle) / width) ** 2) / 2
        )
    share = np.cumsum(1 + dense + np.zeros(len(even)))
    share = (share - share[0]) / (share[-1] - share[0])
    elevation = np.interp(np.linspace(0, 1, count), share, even)
    jitter = rng.normal(0, 0.08 * (up - down) / count, count)
    return np.sort(elevation + jitter)[::-1]


def random_mount(rng: Rng) -> tuple[float, Array]:
    """Draw height above the road in metres, pitch and roll in radians."""
    tilt = np.radians(rng.normal(0, RANDOM_SENSOR["tilt"], 2))
    return float(rng.uniform(*RANDOM_SENSOR["mount"])), tilt


def random_response(rng: Rng) -> Response:
    """Draw noise, limits and brightness of what a sensor reports."""
    ranges = ("noise", "nearest", "farthest", "lost", "threshold", "gain", "gamma")
    low, high = np.array([RANDOM_SENSOR[name] for name in ranges]).T
    values = np.exp(rng.uniform(np.log(low), np.log(high)))
    drawn = dict(zip(ranges, values.tolist(), strict=True))
    return Response(**drawn, levels=int(rng.choice([100, 255])))


def random_shadow(beams: Beams, rng: Rng) -> npt.NDArray[np.bool_]:
    """Draw which rays the vehicle blocks: none, those of a car's outline, or those of a roof."""
    kind = rng.integers(3)
    if kind == 0:
        return np.zeros(len(beams.elevation) * beams.columns, bool)
    if kind == 1:
        return hidden_by_vehicle(beams, rng)
    turn = beams.azimuths()
    wave = np.cos(2 * turn) * rng.uniform(0, 6) + np.cos(turn) * rng.uniform(-3, 3)
    edge = -rng.uniform(*RANDOM_SENSOR["roof"]) + wave
    hidden: npt.NDArray[np.bool_] = np.degrees(beams.elevation)[:, None] < edge
    return hidden.reshape(-1)
