# SPDX-License-Identifier: MIT
"""The network's input from a range image."""

from __future__ import annotations

import numpy as np

from salsanext_cli.records import Float
from salsanext_cli.sensors import Sensor


def normalise(channels: Float, sensor: Sensor) -> Float:
    """Return ``(channel − mean) / std`` where a pixel holds a point, and 0 where it is empty.

    Parameters
    ----------
    channels : (5, H, W) float32
        Range, x, y, z in metres and intensity; a pixel of range 0 is empty.
    sensor : Sensor
        Sensor with the means and standard deviations.

    Returns
    -------
    (5, H, W) float32
        A new array.
    """
    means = np.asarray(sensor.means, np.float32).reshape(-1, 1, 1)
    stds = np.asarray(sensor.stds, np.float32).reshape(-1, 1, 1)
    normal = channels - means
    normal /= stds
    normal[:, channels[0] <= 0] = 0
    return normal
