# SPDX-License-Identifier: MIT
"""The sensor's numbers as the projection kernels take them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from salsanext_cli.sensors import Sensor

LARGEST = np.float32(1e6)
"""Ranges (metres) and intensities above this are no measurements; they would drown the network."""


@dataclass(frozen=True, slots=True)
class ProjectionParameters:
    """The numbers of eq. 1 as the kernels take them, all float32.

    Attributes
    ----------
    fov_down, fov : float32
        Lower edge and extent of the field of view in radians.
    height, width : float32
        Size of the range image in pixels.
    drop : bool
        Whether points above or below the field of view get no pixel instead of the edge row's.
    """

    fov_down: np.float32
    fov: np.float32
    height: np.float32
    width: np.float32
    drop: bool

    @property
    def numbers(self) -> tuple[np.float32, np.float32, np.float32, np.float32, bool]:
        """All fields in their order."""
        return self.fov_down, self.fov, self.height, self.width, self.drop

    @classmethod
    def of(cls, sensor: Sensor) -> ProjectionParameters:
        """Return the view of a sensor; both edges of the field of view are signed."""
        up, down = math.radians(sensor.fov_up), math.radians(sensor.fov_down)
        return cls(
            np.float32(down),
            np.float32(up - down),
            np.float32(sensor.height),
            np.float32(sensor.width),
            sensor.out_of_view == "drop",
        )
