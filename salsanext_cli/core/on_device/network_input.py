# SPDX-License-Identifier: MIT
"""Inputs of a network from the range images of a batch, as `geometry.network_input` makes one."""

from collections.abc import Sequence

import torch
from torch import Tensor

from salsanext_cli.core.engines.device_copies import device_numbers
from salsanext_cli.core.geometry.row_gaps import FILLED_ROWS, fills_rows
from salsanext_cli.core.on_device.intensity import matched_intensity
from salsanext_cli.core.sensors.sensor import Sensor


def network_inputs(channels: Tensor, sensors: Sequence[Sensor], trained: Sensor) -> Tensor:
    """Return the inputs of weights from images of other sensors.

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
        Normalised channels, 0 in empty pixels.
    """
    channels = filled_gaps(matched_intensity(channels, sensors, trained), sensors, trained)
    is_empty = channels[:, :1] <= 0
    # One copy to a GPU instead of two: each is launched.
    statistics = [(sensor.means, sensor.stds) for sensor in sensors]
    means, stds = device_numbers(statistics, channels.device)[..., None, None].unbind(dim=1)
    normal = (channels - means) / stds
    return normal.masked_fill(is_empty, 0)


def filled_gaps(channels: Tensor, sensors: Sequence[Sensor], trained: Sensor) -> Tensor:
    """Return channels (B, 5, H, W) whose gaps are filled where sensors have many more of them."""
    fills = [fills_rows(sensor, trained) for sensor in sensors]
    if not any(fills):
        return channels
    is_filled = device_numbers(fills, channels.device, torch.bool)[:, None, None, None]
    filled = channels.clone()
    for rows in range(1, FILLED_ROWS + 1):
        upper = filled[:, :, :-rows]
        is_gap = (upper[:, :1] <= 0) & is_filled
        filled[:, :, :-rows] = torch.where(is_gap, channels[:, :, rows:], upper)
    return filled
