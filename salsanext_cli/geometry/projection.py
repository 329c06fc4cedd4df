# SPDX-License-Identifier: MIT
"""A scan seen from the sensor: the range image (paper eq. 1).

::

    u = ½ [1 − atan2(y, x)/π] W
    v = [1 − (asin(z/r) − f_down)/(f_up − f_down)] H

Both are rounded down and clamped to the image. Where the sensor names its beams, the row is that of
the point's beam instead (`beam_rows`). The nearest point wins a pixel; of equally near ones the
first in the scan. All arithmetic after the arctangents is float32, as in the published
code, so that points on a pixel border fall to the same side.
"""

import math

import numpy as np

from salsanext_cli.geometry.beam_rows import rows_of
from salsanext_cli.geometry.mounting import without_ego
from salsanext_cli.records import RangeImage, Scan
from salsanext_cli.sensors.sensor import Sensor


def project(scan: Scan, sensor: Sensor, device: str = "cpu") -> RangeImage:
    """Project a scan onto the sensor's range image (paper eq. 1).

    A point has no pixel (index -1, range 0) if a coordinate is NaN or infinite, if it lies at the
    origin or beyond 1000 km, or if it is out of view and the sensor says ``drop``. An intensity
    that is NaN, infinite or beyond a million becomes 0 in the image.

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
    scan = without_ego(scan, sensor)
    up, down = math.radians(sensor.fov_up), math.radians(sensor.fov_down)
    view = (np.float32(down), np.float32(up - down), sensor.height, sensor.width)
    drop, rows = sensor.out_of_view == "drop", rows_of(scan, sensor)
    if device == "cpu":
        from salsanext_cli.geometry import projection_numba

        return projection_numba.project(scan, *view, drop, rows)
    from salsanext_cli.geometry import projection_torch

    return projection_torch.project(scan, *view, drop, rows, device)
