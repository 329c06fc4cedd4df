# SPDX-License-Identifier: MIT
"""A scan seen from the sensor: the range image (paper eq. 1).

::

    u = ½ [1 − atan2(y, x)/π] W
    v = [1 − (asin(z/r) − f_down)/(f_up − f_down)] H

Both are rounded down and clamped to the image. The nearest point wins a pixel; of equally near
ones the first in the scan. All arithmetic after the arctangents is float32, as in the published
code, so that points on a pixel border fall to the same side.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from salsanext_cli.records import RangeImage, Scan
from salsanext_cli.sensors import Sensor


@dataclass(frozen=True, slots=True)
class View:
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
    def of(cls, sensor: Sensor) -> View:
        """Return the view of a sensor; both edges of the field of view are signed."""
        up, down = math.radians(sensor.fov_up), math.radians(sensor.fov_down)
        return cls(
            np.float32(down),
            np.float32(up - down),
            np.float32(sensor.height),
            np.float32(sensor.width),
            sensor.out_of_view == "drop",
        )


def project(scan: Scan, sensor: Sensor, device: str = "cpu") -> RangeImage:
    """Project a scan onto the sensor's range image (paper eq. 1).

    A point has no pixel (index -1, range 0) if a coordinate is NaN or infinite, if it lies at the
    origin, if its range exceeds float32, or if it is out of view and the sensor says ``drop``.
    An intensity that is NaN or infinite becomes 0 in the image.

    Parameters
    ----------
    scan : Scan
        N points; any number, none included.
    sensor : Sensor
        Field of view, image size and what to do with points out of view.
    device : str
        "cpu" (compiled by numba) or a torch device; the result is the same, bit for bit.

    Returns
    -------
    RangeImage
        NumPy arrays, whatever the device.
    """
    if device == "cpu":
        from salsanext_cli.geometry import projection_numba

        return projection_numba.project(scan, View.of(sensor))
    from salsanext_cli.geometry import projection_torch

    return projection_torch.project(scan, View.of(sensor), device)
