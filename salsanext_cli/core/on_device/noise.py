# SPDX-License-Identifier: MIT
"""Noise of sensors on range images of a device, as `uncertainty.aleatoric` has it for one."""

import torch
from torch import Tensor

from salsanext_cli.core.engines.device_copies import device_numbers
from salsanext_cli.core.on_device.network_input import filled_gaps
from salsanext_cli.core.sensors.sensor import Sensor


def noisy_copies(channels: Tensor, sensor: Sensor, draws: Tensor) -> Tensor:
    """Return noisy copies of a range image.

    Parameters
    ----------
    channels : (5, H, W) float32
        Channels of the image.
    sensor : Sensor
        Sensor with its noise along each ray and of its intensity.
    draws : (K, 2, H, W) float32
        Standard normal numbers of `uncertainty.aleatoric.noise_draws`.

    Returns
    -------
    (K, 5, H, W) float32
    """
    noise = sensor.require_noise()
    along, bright = draws.unbind(dim=1)
    moved = channels[:4] + _along_ray(channels) * noise.range * along[:, None]
    intensity = channels[4] + (channels[0] > 0) * noise.intensity * bright
    return torch.cat([moved, intensity[:, None]], dim=1)


def input_variance(channels: Tensor, sensor: Sensor, trained: Sensor) -> Tensor:
    """Return the variance of the input of a network by the noise of the sensor.

    Parameters
    ----------
    channels : (5, H, W) float32
        Channels of an image.
    sensor : Sensor
        Sensor of the image, with its noise.
    trained : Sensor
        Sensor of the weights, which decides whether gaps are filled.

    Returns
    -------
    (1, 5, H, W) float32
        Variance of the normalised channels.
    """
    noise = sensor.require_noise()
    (filled,) = filled_gaps(channels[None], [sensor], trained)
    along = _along_ray(filled) * noise.range
    bright = (filled[:1] > 0) * noise.intensity
    stds = device_numbers(sensor.stds, channels.device)[:, None, None]
    return (torch.cat([along, bright]) / stds).square()[None]


def _along_ray(channels: Tensor) -> Tensor:
    """Return the change (4, H, W) of range, x, y, z per metre of range; 0 for empty pixels."""
    distance = channels[:1]
    direction = (channels[1:4] / distance).where(distance > 0, 0)
    return torch.cat([(distance > 0).float(), direction])
