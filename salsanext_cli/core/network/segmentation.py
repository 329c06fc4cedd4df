# SPDX-License-Identifier: MIT
"""Interface of the networks, for training, prediction, sampling and assumed density filtering."""

from abc import abstractmethod
from typing import Any, ClassVar

import torch
import torch.nn.functional as F
from torch import Tensor, nn


class SegmentationNetwork(nn.Module):
    """Base class of networks in two parts: `trunk`, up to the first dropout, and the `rest`.

    A network uses functions of torch only, so that Gaussians can take the place of tensors. Its
    constructor takes `class_count` and `dropout`.

    Attributes
    ----------
    stride : tuple of int
        Divisors of height and width at the coarsest level; images are padded to multiples of them.
    logits : Conv2d
        The last layer, which takes the result of `decoded`.
    precise : tuple of str
        Parts that stay float32 in a network of 8-bit integers, besides the layers of the image and
        of the logits.
    """

    stride: tuple[int, int]
    logits: nn.Conv2d
    precise: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def trunk(self, image: Tensor) -> tuple[Tensor, ...]:
        """Compute everything before the first dropout: the same for every Monte-Carlo pass."""

    @abstractmethod
    def decoded(self, *features: Any) -> Tensor:
        """Compute the input (B, D, H, W) of the last layer from the result of `trunk`."""

    def rest(self, *features: Any) -> Tensor:
        """Compute the logits (B, C, H, W) from the result of `trunk`."""
        return self.logits(self.decoded(*features))

    def forward(self, image: Tensor) -> Tensor:
        """Map a normalised range image (B, 5, H, W) to logits (B, C, H, W); any H, W."""
        height, width = image.shape[-2:]
        return self.rest(*self.padded_trunk(image))[..., :height, :width]

    def padded_trunk(self, image: Tensor) -> tuple[Tensor, ...]:
        """Compute `trunk` of an image (B, 5, H, W), padded around the circle and by empty rows."""
        height, width = image.shape[-2:]
        padded_width = -(-width // self.stride[1]) * self.stride[1]
        if padded_width != width:
            image = image[..., torch.arange(padded_width, device=image.device) % width]
        return self.trunk(F.pad(image, (0, 0, 0, -height % self.stride[0])))
