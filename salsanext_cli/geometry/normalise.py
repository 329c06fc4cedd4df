# SPDX-License-Identifier: MIT
"""The network's input from a range image, and its variance by the sensor's noise."""

import numpy as np

from salsanext_cli.errors import UsageError
from salsanext_cli.records import Float
from salsanext_cli.sensors.sensor import Sensor


def normalise(channels: Float, sensor: Sensor) -> Float:
    """Return ``(channel − mean) / std`` where a pixel holds a point, and 0 where it is empty.

    `channels` (5, H, W) float32, range, x, y, z in metres and intensity; a pixel of range 0 is
    empty; `sensor`: sensor with the means and standard deviations.

    Returns (5, H, W) float32, a new array.
    """
    means = np.asarray(sensor.means, np.float32).reshape(-1, 1, 1)
    stds = np.asarray(sensor.stds, np.float32).reshape(-1, 1, 1)
    normal = channels - means
    normal /= stds
    normal[:, channels[0] <= 0] = 0
    return normal


def input_variance(channels: Float, sensor: Sensor) -> Float:
    """Return the variance of every number of a normalised range image.

    A range that is wrong by δ moves the point along its ray: x by δ x/r, y and z alike. Empty
    pixels are certain.

    `channels` (5, H, W) float32, range, x, y, z in metres and intensity; a pixel of range 0 is
    empty; `sensor`: its noise in metres and units of intensity, its stds.

    Returns (5, H, W) float32, in squared units of the normalised channels.
    """
    range_noise, intensity_noise = noise_of(sensor)
    occupied = channels[0] > 0
    deviations = np.zeros_like(channels)
    deviations[0] = 1
    np.divide(channels[1:4], channels[0], out=deviations[1:4], where=occupied)
    deviations[:4] *= range_noise
    deviations[4] = intensity_noise
    deviations /= np.asarray(sensor.stds, np.float32).reshape(-1, 1, 1)
    variance: Float = np.where(occupied, np.square(deviations), np.float32(0))
    return variance


def noise_of(sensor: Sensor) -> tuple[float, float]:
    """Return the noise of ranges (metres) and of intensities, as standard deviations."""
    if sensor.range_noise is None or sensor.intensity_noise is None:
        raise UsageError(
            f"sensor {sensor.name}",
            "its noise is not known",
            "range_noise in metres and intensity_noise",
            "write both into a sensor's .toml and give it with --sensor",
        )
    return sensor.range_noise, sensor.intensity_noise
