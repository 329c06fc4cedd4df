# SPDX-License-Identifier: MIT
"""Samples of the pixels of range images, those that `geometry.intensity` takes of one."""

from dataclasses import dataclass
from functools import lru_cache

import torch
from torch import Tensor

from salsanext_cli.core.engines.device_copies import device_numbers
from salsanext_cli.core.geometry.intensity import SAMPLE
from salsanext_cli.core.geometry.point_sample import sample_shares


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PixelSample:
    """Sample of the occupied pixels of each of B range images, in the order of the pixels.

    Attributes
    ----------
    points : (B, 3, S) float32
        Coordinates in metres.
    intensity : (B, S) float32
        Values of the points.
    counts : (B, 1) int64
        Number of sampled pixels of each image, up to S; what follows them is not used.
    """

    points: Tensor
    intensity: Tensor
    counts: Tensor

    @classmethod
    def from_channels(cls, channels: Tensor) -> "PixelSample":
        """Return the sample of images (B, 5, H, W); all occupied pixels where they are few."""
        occupied = (channels[:, 0] > 0).flatten(1)
        ranks = occupied.cumsum(dim=1)
        counts = ranks[:, -1:]
        in_order = torch.arange(SAMPLE, device=counts.device)
        shares = _shares(str(counts.device))
        place = torch.where(counts > SAMPLE, (shares * counts).long(), in_order)
        pixel = torch.searchsorted(ranks, place + 1).clamp(max=ranks.shape[1] - 1)
        values = channels.flatten(2)[:, 1:].gather(2, pixel[:, None].expand(-1, 4, -1))
        return cls(
            points=values[:, :3],
            intensity=values[:, 3].contiguous(),
            counts=counts.clamp(max=SAMPLE),
        )

    @property
    def is_sampled(self) -> Tensor:
        """Places that hold a sampled pixel, (B, S) bool."""
        places = torch.arange(self.intensity.shape[1], device=self.counts.device)
        return places < self.counts


@lru_cache(maxsize=8)
def _shares(device: str) -> Tensor:
    """Return the places of the sample as shares of the occupied pixels, (S,) float64."""
    return device_numbers(sample_shares(SAMPLE), device, torch.float64)
