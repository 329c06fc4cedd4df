# SPDX-License-Identifier: MIT
"""Range images whose values are no intensities, decided on the device for a whole batch.

The rules are those of `geometry.intensity.why_no_intensity`. Pixels have only points that are
measured and values that are usable, so that the rules about others are not needed.
"""

import torch
from torch import Tensor

from salsanext_cli.core.geometry.intensity import MAX_DEPENDENCE, MAX_EQUAL, MIN_INTENSITY_POINTS
from salsanext_cli.core.on_device.pixel_sample import PixelSample
from salsanext_cli.core.on_device.projection import arctan2


def lack_intensity(sample: PixelSample) -> Tensor:
    """Return which images hold values that are no intensities, (B,) bool."""
    is_sampled = sample.is_sampled
    ordered = sample.intensity.where(is_sampled, torch.inf).sort(dim=1).values
    below = torch.searchsorted(ordered, sample.intensity)
    at_most = torch.searchsorted(ordered, sample.intensity, right=True)
    largest_group = (at_most - below).where(is_sampled, 0).amax(dim=1)
    is_equal = largest_group / sample.counts[:, 0].double() > MAX_EQUAL
    return is_equal | _is_dependent(sample, below, at_most)


def _is_dependent(sample: PixelSample, below: Tensor, at_most: Tensor) -> Tensor:
    """Return whether the values of each image follow a property of its points, (B,) bool.

    This is Chatterjee's coefficient, as of `geometry.intensity.dependence`.

    Parameters
    ----------
    sample : PixelSample
        Sample of S pixels of each of B images.
    below, at_most : (B, S) int64
        Number of sampled values below, and at most, each value.

    Returns
    -------
    (B,) bool
    """
    counts = sample.counts[:, 0]
    from_above = (sample.counts - below).where(sample.is_sampled, 0)
    spread = (from_above * (sample.counts - from_above)).sum(dim=1)
    steps = [_steps(sample, at_most, values) for values in _properties(sample)]
    fewest = torch.stack(steps).amin(dim=0)
    dependence = 1 - (counts * fewest).double() / (2 * spread)
    return (counts >= MIN_INTENSITY_POINTS) & (dependence > MAX_DEPENDENCE)


def _properties(sample: PixelSample) -> list[Tensor]:
    """Return range, elevation, azimuth and order of points, (B, S) each."""
    x, y, z = sample.points.double().unbind(dim=1)
    ranges = (x * x + y * y + z * z).sqrt()
    order = torch.arange(ranges.shape[1], device=ranges.device).expand(ranges.shape)
    return [ranges, z / ranges, arctan2(y, x).float(), order]


def _steps(sample: PixelSample, ranks: Tensor, values: Tensor) -> Tensor:
    """Return the sum of the steps between ranks (B, S) in the order of values (B, S), (B,)."""
    last = torch.iinfo(torch.int64).max if values.dtype == torch.int64 else torch.inf
    order = values.where(sample.is_sampled, last).argsort(dim=1, stable=True)
    steps = ranks.gather(1, order).diff(dim=1).abs()
    return steps.where(sample.is_sampled[:, 1:], 0).sum(dim=1)
