# SPDX-License-Identifier: MIT
"""Intensities of a batch on the scale of training, as `geometry.intensity` maps an image."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from salsanext_cli.core.engines.device_copies import device_numbers
from salsanext_cli.core.geometry.intensity import NO_INTENSITY, scale_table
from salsanext_cli.core.on_device.no_intensity import lack_intensity
from salsanext_cli.core.on_device.pixel_sample import PixelSample
from salsanext_cli.core.records import Double
from salsanext_cli.core.sensors.sensor import INTENSITY_LEVELS, Sensor

INTENSITY = 4  # Channel of the intensity


def matched_intensity(channels: Tensor, sensors: Sequence[Sensor], trained: Sensor) -> Tensor:
    """Return channels whose intensities are on the scale of training.

    Parameters
    ----------
    channels : (B, 5, H, W) float32
        Channels of range images; 0 where empty.
    sensors : sequence of Sensor
        Sensor of each image.
    trained : Sensor
        Sensor of the weights.

    Returns
    -------
    (B, 5, H, W) float32
    """
    device = channels.device
    target = trained.intensity_quantiles
    sources = [sensor.intensity_quantiles for sensor in sensors]
    if not target or not any(sources):
        return channels
    tables = np.stack([padded_table(source or target, target) for source in sources])
    empty_table = device_numbers(padded_table(NO_INTENSITY, target), device, torch.float64)
    is_known = device_numbers([bool(source) for source in sources], device, torch.bool)
    is_other = device_numbers([source != target for source in sources], device, torch.bool)
    has_none = is_known & lack_intensity(PixelSample.from_channels(channels))
    sensor_tables = device_numbers(tables, device, torch.float64)
    table = torch.where(has_none[:, None, None], empty_table, sensor_tables)
    values, targets = table.unbind(dim=1)
    raw = channels[:, INTENSITY]
    mapped = interpolated(raw.flatten(1), values, targets).view(raw.shape)
    is_mapped = has_none | (is_known & is_other)
    matched = channels.clone()
    matched[:, INTENSITY] = mapped.where(is_mapped[:, None, None] & (channels[:, 0] > 0), raw)
    return matched


@lru_cache(maxsize=64)
def padded_table(source: tuple[float, ...], target: tuple[float, ...]) -> Double:
    """Return the scale table of quantiles, with its last column repeated.

    Parameters
    ----------
    source : tuple of float
        Quantiles of a sensor.
    target : tuple of float
        Quantiles of training, at the same levels.

    Returns
    -------
    (2, INTENSITY_LEVELS) float64
        Values of the sensor, rising, and of training.
    """
    table = np.stack(scale_table(source, target))
    return np.pad(table, ((0, 0), (0, INTENSITY_LEVELS - table.shape[1])), mode="edge")


def interpolated(intensity: Tensor, values: Tensor, targets: Tensor) -> Tensor:
    """Return intensities on other scales, as `numpy.interp` in float64.

    Parameters
    ----------
    intensity : (B, P) float32
        Intensities of each image.
    values : (B, K) float64
        Rising values, of which the last may be repeated.
    targets : (B, K) float64
        Their targets.

    Returns
    -------
    (B, P) float32
    """
    exact = intensity.double().contiguous()
    after = torch.searchsorted(values.contiguous(), exact, right=True)
    after = after.clamp(1, values.shape[1] - 1)
    low = values.gather(1, after - 1)
    low_target = targets.gather(1, after - 1)
    slope = (targets.gather(1, after) - low_target) / (values.gather(1, after) - low)
    between = slope * (exact - low) + low_target
    mapped = torch.where(exact < values[:, :1], targets[:, :1], between)
    return torch.where(exact >= values[:, -1:], targets[:, -1:], mapped).float()
