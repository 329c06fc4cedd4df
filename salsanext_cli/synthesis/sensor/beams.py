# SPDX-License-Identifier: MIT
"""Beams of a rotating sensor: angles, order and timing of their firings."""

from dataclasses import dataclass

import numpy as np

from salsanext_cli.synthesis.mesh import Array

ENCODER_STEP_DEG = 0.09
"""Resolution of the azimuth."""
REVOLUTION_S = 0.1


@dataclass(frozen=True, slots=True)
class Beams:
    """The lasers of one sensor, upper ones first; L of them."""

    elevation: Array  # (L,): radians
    azimuth: Array  # (L,): offset of the first firing, radians
    # (L,): where the beam starts, metres above and to the left of the sensor's origin
    height: Array
    aside: Array
    # (L,): brightness that the laser reports relative to the others, and what it reports less
    gain: Array
    offset: Array
    power: Array  # (L,): strength of the pulse relative to the others
    columns: int  # Firings per revolution

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
        horizontal = np.cos(elevation)
        x, y = np.cos(azimuth), np.sin(azimuth)
        directions = np.stack([horizontal * x, horizontal * y, np.sin(elevation)], -1)
        aside = self.aside[:, None]
        height = np.broadcast_to(self.height[:, None], azimuth.shape)
        origins = np.stack([-y * aside, x * aside, height], -1)
        turned = np.mod(np.pi - azimuth, 2 * np.pi) / (2 * np.pi)
        times = (turned - 0.5) * REVOLUTION_S
        return origins.reshape(-1, 3), directions.reshape(-1, 3), times.reshape(-1)
