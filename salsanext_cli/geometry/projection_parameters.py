# SPDX-License-Identifier: MIT
"""Parameters of the projection, in the form of the kernels' arguments."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from salsanext_cli.sensors import Sensor

LARGEST = np.float32(1e6)
"""Largest range in metres, and largest intensity, that counts as a measurement."""


class ProjectionParameters(NamedTuple):
    """Numbers of eq. 1, in the order of the kernels' arguments.

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

    @classmethod
    def of(cls, sensor: Sensor) -> ProjectionParameters:
        """Return the parameters of a sensor; both edges of the field of view are signed."""
        up, down = math.radians(sensor.fov_up), math.radians(sensor.fov_down)
        return cls(
            np.float32(down),
            np.float32(up - down),
            np.float32(sensor.height),
            np.float32(sensor.width),
            sensor.out_of_view == "drop",
        )
