# SPDX-License-Identifier: MIT
"""Inputs of a network from the range images of a batch, as `geometry.network_input` makes one.

Whether the values of an image are intensities is decided on the host, by a sample of its pixels.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from salsanext_cli.core.geometry.intensity import SAMPLE, quantiles_to_match, scale_table
from salsanext_cli.core.geometry.point_sample import sample_shares
from salsanext_cli.core.geometry.row_gaps import FILLED_ROWS, fills_rows
from salsanext_cli.core.on_device.projection import RangeImages
from salsanext_cli.core.records import Double, Float
from salsanext_cli.core.sensors.sensor import INTENSITY_LEVELS, Sensor

INTENSITY = 4  # Channel of the intensity


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scale:
    """Map of the intensities of one image to those of training.

    Attributes
    ----------
    values : (K,) float64
        Different quantiles of its sensor, rising.
    targets : (K,) float64
        Intensities of training.
    """

    values: Double
    targets: Double

    def padded(self) -> Double:
        """Return values and targets, (2, INTENSITY_LEVELS): the last of them repeated."""
        table = np.stack([self.values, self.targets])
        return np.pad(table, ((0, 0), (0, INTENSITY_LEVELS - len(self.values))), mode="edge")


def network_inputs(images: RangeImages, sensors: Sequence[Sensor], trained: Sensor) -> Tensor:
    """Return the inputs of weights from images of other sensors.

    Parameters
    ----------
    images : RangeImages
        B range images.
    sensors : sequence of Sensor
        Sensor of each image.
    trained : Sensor
        Sensor of the weights.

    Returns
    -------
    (B, 5, H, W) float32
        Normalised channels, 0 in empty pixels.
    """
    channels = _filled(_matched(images, sensors, trained), sensors, trained)
    is_empty = channels[:, :1] <= 0
    means = channels.new_tensor([sensor.means for sensor in sensors])[:, :, None, None]
    stds = channels.new_tensor([sensor.stds for sensor in sensors])[:, :, None, None]
    return ((channels - means) / stds).masked_fill(is_empty, 0)


def _matched(images: RangeImages, sensors: Sequence[Sensor], trained: Sensor) -> Tensor:
    """Return channels (B, 5, H, W) whose intensities are on the scale of training."""
    channels = images.channels
    target = trained.intensity_quantiles
    if not target or not any(sensor.intensity_quantiles for sensor in sensors):
        return channels
    scales: list[Scale | None] = []
    for sensor, (points, intensity) in zip(sensors, _samples(images), strict=True):
        source = sensor.intensity_quantiles
        quantiles = quantiles_to_match(points, intensity, source, target) if source else None
        scales.append(None if quantiles is None else _scale(quantiles, target))
    if not any(scales):
        return channels
    unused = Scale(values=np.zeros(1), targets=np.zeros(1))
    tables = np.stack([(scale or unused).padded() for scale in scales])
    values, targets = torch.from_numpy(tables).to(channels.device).unbind(dim=1)
    raw = channels[:, INTENSITY]
    mapped = _interpolated(raw.flatten(1), values, targets).view(raw.shape)
    is_mapped = torch.tensor([scale is not None for scale in scales], device=channels.device)
    matched = channels.clone()
    matched[:, INTENSITY] = mapped.where(is_mapped[:, None, None] & images.occupied, raw)
    return matched


def _scale(source: Sequence[float], target: Sequence[float]) -> Scale:
    values, targets = scale_table(source, target)
    return Scale(values=values, targets=targets)


def _samples(images: RangeImages) -> list[tuple[Float, Float]]:
    """Return points (M, 3) and values (M,) of a sample of the occupied pixels of each image.

    The pixels are those that `match_intensity` takes.
    """
    occupied = images.occupied.flatten(1)
    ranks = occupied.cumsum(dim=1)
    counts = ranks[:, -1:]
    shares = torch.from_numpy(sample_shares(SAMPLE)).to(counts.device)
    in_order = torch.arange(SAMPLE, device=counts.device)
    place = torch.where(counts > SAMPLE, (shares * counts).long(), in_order)
    pixel = torch.searchsorted(ranks, place + 1).clamp(max=ranks.shape[1] - 1)
    values = images.channels.flatten(2)[:, 1:].gather(2, pixel[:, None].expand(-1, 4, -1))
    samples = []
    for sample, count in zip(values.cpu().numpy(), counts[:, 0].tolist(), strict=True):
        taken = sample[:, : min(count, SAMPLE)]
        samples.append((taken[:3].T, taken[3]))
    return samples


def _interpolated(intensity: Tensor, values: Tensor, targets: Tensor) -> Tensor:
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


def _filled(channels: Tensor, sensors: Sequence[Sensor], trained: Sensor) -> Tensor:
    """Return channels (B, 5, H, W) whose gaps are filled where sensors have many more of them."""
    fills = [fills_rows(sensor, trained) for sensor in sensors]
    if not any(fills):
        return channels
    is_filled = torch.tensor(fills, device=channels.device)[:, None, None, None]
    filled = channels.clone()
    for rows in range(1, FILLED_ROWS + 1):
        upper = filled[:, :, :-rows]
        is_gap = (upper[:, :1] <= 0) & is_filled
        filled[:, :, :-rows] = torch.where(is_gap, channels[:, :, rows:], upper)
    return filled
