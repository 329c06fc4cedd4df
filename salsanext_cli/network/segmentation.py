# SPDX-License-Identifier: MIT
"""What training, prediction, sampling and the moments ask of any network."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

MOST_CLASSES = 255
"""What train ids of one byte can tell apart, one value being kept for "unknown"."""


class SegmentationNetwork(nn.Module):
    """A network of two parts: `trunk`, up to the first dropout, and the `rest`.

    Both are written for tensors of sizes that `stride` divides, and with functions of torch only,
    so that Gaussians and intervals can take the place of tensors.

    Attributes
    ----------
    stride : (int, int)
        What height and width are divided by at the narrowest place.
    in_parts : bool
        Whether it shares its work among threads by itself; see `parts`.
    """

    stride: tuple[int, int]
    parallel_for = False

    @abstractmethod
    def trunk(self, image: Tensor) -> tuple[Tensor, ...]:
        """Compute everything before the first dropout: the same for every Monte-Carlo pass."""

    @abstractmethod
    def rest(self, *features: Any) -> Tensor:
        """Compute the logits (B, C, H, W) from what `trunk` returns."""

    def forward(self, image: Tensor) -> Tensor:
        """Map a normalised range image (B, 5, H, W) to logits (B, C, H, W); any H, W."""
        height, width = image.shape[-2:]
        return self.rest(*self.trunk(self.pad(image)))[..., :height, :width]

    def pad(self, image: Tensor) -> Tensor:
        """Extend (B, 5, H, W) so that `stride` divides it: azimuth goes round, below is empty."""
        height, width = image.shape[-2:]
        padded_width = -(-width // self.stride[1]) * self.stride[1]
        if padded_width != width:
            image = image[..., torch.arange(padded_width, device=image.device) % width]
        return F.pad(image, (0, 0, 0, -height % self.stride[0]))


def require_classes(count: int) -> None:
    """Raise `ValueError` unless labels of one byte can tell so many classes apart."""
    if not 1 <= count <= MOST_CLASSES:
        raise ValueError(f"1 to {MOST_CLASSES} classes, not {count}")
