# SPDX-License-Identifier: MIT
"""Aleatoric uncertainty: the sensor's noise carried through the network (paper III-C.1)."""

from collections.abc import Iterator
from itertools import islice

import numpy as np
from torch import Tensor

from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.geometry.row_gaps import with_filled_gaps
from salsanext_cli.core.network.segmentation import SegmentationNetwork
from salsanext_cli.core.records import Float, RangeImage
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.uncertainty.adf import Gaussian

COPIES = 8  # Noisy copies of a scan; 8 rank pixels like 256 (correlation 0.97)


def _along_ray(channels: Float) -> Float:
    """Return the change (4, H, W) of range, x, y, z per metre of range; 0 for empty pixels."""
    occupied = channels[0] > 0
    change = np.zeros_like(channels[:4])
    change[0] = occupied
    np.divide(channels[1:4], channels[0], out=change[1:], where=occupied)
    return change


def noise_draws(size: tuple[int, ...], seed: int) -> Iterator[Float]:
    """Yield standard normal numbers (2, H, W) float32 endlessly: along the rays, of intensities."""
    random = np.random.default_rng(seed)
    while True:
        yield random.standard_normal((2, *size), np.float32)


def noisy_copies(image: RangeImage, sensor: Sensor, seed: int) -> Iterator[Float]:
    """Yield noisy copies of a range image endlessly.

    Parameters
    ----------
    image : RangeImage
        H × W pixels.
    sensor : Sensor
        Sensor with its noise along each ray and of its intensity.
    seed : int
        Seed of the noise.

    Yields
    ------
    (5, H, W) float32
        Channels.
    """
    noise = sensor.require_noise()
    occupied = image.channels[0] > 0
    step = _along_ray(image.channels)
    for along, bright in noise_draws(occupied.shape, seed):
        copy = image.channels.copy()
        copy[:4] += step * np.float32(noise.range) * along
        copy[4] += occupied * np.float32(noise.intensity) * bright
        yield copy


def input_variance(channels: Float, sensor: Sensor) -> Float:
    """Return the variance (5, H, W) float32 of normalised channels (5, H, W)."""
    noise = sensor.require_noise()
    deviations = np.zeros_like(channels)
    deviations[:4] = _along_ray(channels)
    deviations[:4] *= noise.range
    deviations[4] = (channels[0] > 0) * np.float32(noise.intensity)
    deviations /= np.asarray(sensor.stds, np.float32).reshape(-1, 1, 1)
    return np.square(deviations)


def noise_variance(network: Network, image: RangeImage, seed: int) -> Float:
    """Return the unbiased variance of the softmax over noisy copies.

    Parameters
    ----------
    network : Network
        Network for the sensor of the image.
    image : RangeImage
        H × W pixels.
    seed : int
        Seed of the noise.

    Returns
    -------
    (C, H, W) float32
    """
    copies = islice(noisy_copies(image, network.sensor, seed), COPIES)
    return network.backend.spread(map(network.input, copies), network.merging)


def aleatoric(network: Network, image: RangeImage) -> Float:
    """Return the variance (C, H, W) of the softmax of unmerged classes by density filtering."""
    filled = with_filled_gaps(image.channels, network.sensor, network.card.sensor)
    variance = input_variance(filled, network.sensor)[None]
    mean = network.input(image.channels)
    logits, logits_variance = network.backend.run("moments", moments, mean, variance, exact=True)
    softmax = Gaussian(logits, logits_variance).softmax(dim=1)
    return softmax.variance[0].cpu().numpy()


def moments(module: SegmentationNetwork, mean: Tensor, variance: Tensor) -> tuple[Tensor, Tensor]:
    """Return mean and variance of the logits from mean and variance (B, 5, H, W) of the input."""
    logits: Gaussian = module(Gaussian(mean, variance))
    return logits.mean, logits.variance
