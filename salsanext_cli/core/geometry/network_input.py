# SPDX-License-Identifier: MIT
"""Input of a network from a range image: intensity and row gaps as in training, normalised."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from salsanext_cli.core.geometry.intensity import intensity_quantiles, match_intensity
from salsanext_cli.core.geometry.row_gaps import row_gaps, with_filled_gaps
from salsanext_cli.core.records import Float
from salsanext_cli.core.sensors.sensor import Sensor


def network_input(channels: Float, sensor: Sensor, trained: Sensor) -> Float:
    """Return the input of weights from channels of another sensor.

    Parameters
    ----------
    channels : (5, H, W) float32
        Range image: range, x, y, z in metres, intensity.
    sensor : Sensor
        Sensor of the image, fitted to its scans.
    trained : Sensor
        Sensor of the weights.

    Returns
    -------
    (1, 5, H, W) float32
        Normalised channels.
    """
    source = sensor.intensity_quantiles
    target = trained.intensity_quantiles
    if source and target:
        channels = match_intensity(channels, source, target)
    return normalise(with_filled_gaps(channels, sensor, trained), sensor)[None]


def normalise(channels: Float, sensor: Sensor) -> Float:
    """Return ``(channel − mean) / std``, (5, H, W) float32; 0 in empty pixels."""
    means = np.asarray(sensor.means, np.float32).reshape(-1, 1, 1)
    stds = np.asarray(sensor.stds, np.float32).reshape(-1, 1, 1)
    normal = channels - means
    normal /= stds
    normal[:, channels[0] <= 0] = 0
    return normal


def with_image_statistics(sensor: Sensor, images: Sequence[Float]) -> Sensor:
    """Return the sensor with the intensity and the gaps of its range images, (5, H, W) each."""
    quantiles = intensity_quantiles(images)
    return replace(sensor, intensity_quantiles=quantiles, row_gaps=row_gaps(images))
