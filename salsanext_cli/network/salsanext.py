# SPDX-License-Identifier: MIT
"""SalsaNext (arXiv 2003.03653, Figure 2): range image in, logits out."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from salsanext_cli.network.blocks import ContextBlock, Down, ResidualBlock, UpBlock
from salsanext_cli.network.dropout import ChannelDropout
from salsanext_cli.records import CHANNELS

STRIDE = 16
"""What four poolings divide height and width by."""
MOST_CLASSES = 255
"""What train ids of one byte can tell apart, one value being kept for "unknown"."""


class SalsaNext(nn.Module):
    """The second version of the paper; 6 711 572 parameters with 20 classes.

    Parameters
    ----------
    class_count : int
        C, including the unlabelled class 0.
    dropout : float
        Rate of the channel dropout, 0 ≤ rate < 1; the paper trains with 0.2.
    """

    def __init__(self, class_count: int = 20, dropout: float = 0.2) -> None:
        super().__init__()
        if not 1 <= class_count <= MOST_CLASSES:
            raise ValueError(f"1 to {MOST_CLASSES} classes, not {class_count}")
        self.context = nn.Sequential(
            ContextBlock(len(CHANNELS), 32), ContextBlock(32, 32), ContextBlock(32, 32)
        )
        self.block1 = ResidualBlock(32, 64)
        self.block2 = ResidualBlock(64, 128)
        self.block3 = ResidualBlock(128, 256)
        self.block4 = ResidualBlock(256, 256)
        self.block5 = ResidualBlock(256, 256)
        self.down1 = Down(0.0)
        self.down2 = Down(dropout)
        self.down3 = Down(dropout)
        self.down4 = Down(dropout)
        self.bottom = ChannelDropout(dropout)
        self.up1 = UpBlock(256, 256, 128, dropout)
        self.up2 = UpBlock(128, 256, 128, dropout)
        self.up3 = UpBlock(128, 128, 64, dropout)
        self.up4 = UpBlock(64, 64, 32, 0.0)
        self.logits = nn.Conv2d(32, class_count, 1)

    def forward(self, image: Tensor) -> Tensor:
        """Map a normalised range image (B, 5, H, W) to logits (B, C, H, W); any H, W."""
        height, width = image.shape[-2:]
        return self.rest(*self.trunk(pad(image)))[..., :height, :width]

    def trunk(self, image: Tensor) -> tuple[Tensor, Tensor]:
        """Compute everything before the first dropout: the same for every Monte-Carlo pass.

        Takes (B, 5, H, W) with H and W divisible by 16; returns the features of blocks 1 and 2,
        (B, 64, H, W) and (B, 128, H/2, W/2).
        """
        features1 = self.block1(self.context(image))
        features2 = self.block2(self.down1(features1))
        return features1, features2

    def rest(self, features1: Tensor, features2: Tensor) -> Tensor:
        """Compute the logits (B, C, H, W) from what `trunk` returns."""
        features3 = self.block3(self.down2(features2))
        features4 = self.block4(self.down3(features3))
        features5 = self.bottom(self.block5(self.down4(features4)))
        raised = self.up1(features5, features4)
        raised = self.up2(raised, features3)
        raised = self.up3(raised, features2)
        raised = self.up4(raised, features1)
        logits: Tensor = self.logits(raised)
        return logits


def pad(image: Tensor) -> Tensor:
    """Extend (B, 5, H, W) so that 16 divides H and W: azimuth goes round, below is empty."""
    height, width = image.shape[-2:]
    padded_width = -(-width // STRIDE) * STRIDE
    if padded_width != width:
        image = image[..., torch.arange(padded_width, device=image.device) % width]
    return F.pad(image, (0, 0, 0, -height % STRIDE))
