# SPDX-License-Identifier: MIT
"""Intensities on the scale of another sensor: each quantile becomes the other's."""

from collections.abc import Iterable, Sequence

import numpy as np

from salsanext_cli.records import Float
from salsanext_cli.sensors import INTENSITY_LEVELS

DIGITS = 6
"""Significant digits of a quantile."""
BRIGHT = 0.95
"""Quantile of the upper intensities, which tell the scale."""
INTENSITY_FACTOR = 4.0
"""Largest factor between the upper intensities of scans of one scale."""


def intensity_quantiles(images: Iterable[Float]) -> tuple[float, ...]:
    """Return the quantiles of intensity, the mean of those of each range image.

    Images of another scale than most, and without intensity, do not count beside others.

    Parameters
    ----------
    images : iterable of (5, H, W) float32
        Channels; pixels of range 0 are empty and do not count, nor do images without any others.

    Returns
    -------
    tuple of `INTENSITY_LEVELS` floats, or none without a pixel
        From the smallest to the largest value.
    """
    levels = np.linspace(0, 1, INTENSITY_LEVELS)
    occupied = [channels[4][channels[0] > 0] for channels in images]
    found = [np.quantile(values, levels) for values in occupied if len(values)]
    if not found:
        return ()
    each = np.array(found)
    varied = each[:, -1] > each[:, 0]
    each = each[varied] if varied.any() else each
    upper = each[:, round(BRIGHT * (INTENSITY_LEVELS - 1))]
    usual = np.sort(upper)[len(upper) // 2]
    if usual > 0:  # Decibels have no factors.
        each = each[(upper * INTENSITY_FACTOR >= usual) & (upper <= usual * INTENSITY_FACTOR)]
    return tuple(float(f"{value:.{DIGITS}g}") for value in each.mean(axis=0))


def match_intensity(channels: Float, source: Sequence[float], target: Sequence[float]) -> Float:
    """Return a range image with the quantiles of its intensity mapped to others, linearly between.

    A value at which several quantiles lie becomes the mean of theirs: so a scan without intensity,
    0 everywhere, gets the mean of the target.

    Parameters
    ----------
    channels : (5, H, W) float32
        Empty pixels, of range 0, stay 0.
    source, target : sequence of float
        Quantiles of the sensor and of the scale wanted, at the same levels.

    Returns
    -------
    (5, H, W) float32
        A new array.
    """
    values, place = np.unique(np.asarray(source), return_inverse=True)
    wanted = np.bincount(place, target) / np.bincount(place)
    matched = channels.copy()
    matched[4] = np.interp(channels[4], values, wanted)
    matched[4][channels[0] <= 0] = 0
    return matched
