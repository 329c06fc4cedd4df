# SPDX-License-Identifier: MIT
"""Beams of an HDL-64E: 64 lasers in two blocks, about 2160 firings of each per revolution."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from salsanext_cli.synthesis.mesh import Array, Rng
from salsanext_cli.synthesis.presets import VEHICLE_OUTLINES_DEG

UPPER_BLOCK, LOWER_BLOCK = (2.4, -8.0, 32), (-8.6, -23.9, 32)
"""Elevation of the first and the last beam of a block in degrees, and their number."""
AZIMUTH_STEP_DEG, ENCODER_STEP_DEG = 0.1667, 0.09
"""Angle between firings of a laser at 10 Hz; resolution of the azimuth."""
REVOLUTION_S = 0.1


@dataclass(frozen=True, slots=True)
class Beams:
    """The lasers of one sensor, upper ones first; L of them.

    Attributes
    ----------
    elevation : (L,)
        Radians.
    azimuth : (L,)
        Offset of the first firing, radians.
    height, aside : (L,)
        Where the beam starts, metres above and to the left of the sensor's origin.
    gain : (L,)
        Brightness that the laser reports relative to the others.
    power : (L,)
        Strength of the pulse relative to the others.
    columns : int
        Firings per revolution.
    """

    elevation: Array
    azimuth: Array
    height: Array
    aside: Array
    gain: Array
    power: Array
    columns: int

    def azimuths(self) -> Array:
        """Return the azimuth of each firing, (L, columns), radians, anticlockwise from ahead."""
        tick = np.radians(ENCODER_STEP_DEG)
        step = np.arange(self.columns) * (2 * np.pi / self.columns)
        azimuth: Array = np.floor(step / tick) * tick + self.azimuth[:, None]
        return azimuth

    def rays(self) -> tuple[Array, Array, Array]:
        """Return origins and directions (L * columns, 3), sensor frame, and the time of each.

        In the order of KITTI's files: laser by laser from the top, each once around from
        straight ahead to the left. The time (L * columns,) is in seconds; the sensor turns
        clockwise from behind and looks ahead at time 0.
        """
        azimuth = self.azimuths()
        elevation = np.broadcast_to(self.elevation[:, None], azimuth.shape)
        level = np.cos(elevation)
        x, y = np.cos(azimuth), np.sin(azimuth)
        directions = np.stack([level * x, level * y, np.sin(elevation)], -1)
        aside = self.aside[:, None]
        height = np.broadcast_to(self.height[:, None], azimuth.shape)
        origins = np.stack([-y * aside, x * aside, height], -1)
        turned = np.mod(np.pi - azimuth, 2 * np.pi) / (2 * np.pi)
        times = (turned - 0.5) * REVOLUTION_S
        return origins.reshape(-1, 3), directions.reshape(-1, 3), times.reshape(-1)


def hdl64(rng: Rng) -> Beams:
    """Return the beams of one HDL-64E with its own small deviations."""
    elevation = np.concatenate([np.linspace(*UPPER_BLOCK), np.linspace(*LOWER_BLOCK)])
    elevation = elevation + rng.normal(0, 0.045, 64) + rng.normal(0, 0.06)
    columns = round(360 / (AZIMUTH_STEP_DEG + rng.normal(0, 0.0006)))
    gain = rng.normal(1, 0.08, 64)
    weak = rng.random(64) < 0.06
    gain[weak] *= rng.uniform(0.6, 0.85, int(weak.sum()))
    return Beams(
        np.radians(np.sort(elevation)[::-1]),
        rng.uniform(0, 2 * np.pi / columns, 64),
        np.repeat([0.05, 0.0], 32) + rng.normal(0, 0.003, 64),
        np.tile([0.026, -0.026], 32),
        gain,
        np.exp(rng.normal(0, 0.5, 64)),
        columns,
    )


PARALLAX_DEG = 1.2
"""Shift of the vehicle as seen by lasers to the left and right of the axis."""


def hidden_by_vehicle(beams: Beams, rng: Rng) -> npt.NDArray[np.bool_]:
    """Return the rays that the recording vehicle blocks, (L * columns,); mounting varies a bit."""
    azimuth = np.degrees(beams.azimuths()) + PARALLAX_DEG * np.sign(beams.aside)[:, None]
    elevation = np.degrees(beams.elevation)[:, None]
    hidden = np.zeros(azimuth.shape, bool)
    for outline in VEHICLE_OUTLINES_DEG:
        corner, upper, lower = outline.T
        beyond = np.mod(azimuth - corner[0] - rng.normal(0, 0.3), 360)
        shift = rng.normal(0, 0.3)
        below = elevation < np.interp(beyond, corner - corner[0], upper, right=-90) + shift
        hidden |= below & (elevation > np.interp(beyond, corner - corner[0], lower, right=-90))
    return hidden.reshape(-1)
