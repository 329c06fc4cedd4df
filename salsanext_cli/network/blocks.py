# SPDX-License-Identifier: MIT
"""Building blocks of SalsaNext (paper III-B, Figure 2).

Every block is a plain composition of elementary modules, so that a network of variances can be
derived from it instead of written again.
"""

import torch
from torch import Tensor, nn

from salsanext_cli.network.dropout import ChannelDropout

SLOPE = 0.01


class Unit(nn.Sequential):
    """Convolution → LeakyReLU → batch norm, size preserving: (B, in, H, W) → (B, out, H, W)."""

    def __init__(self, inputs: int, outputs: int, kernel: int, dilation: int = 1) -> None:
        # A 2×2 kernel keeps its size only with dilation 2 and padding 1.
        padding = dilation * (kernel - 1) // 2
        super().__init__(
            nn.Conv2d(inputs, outputs, kernel, padding=padding, dilation=dilation),
            nn.LeakyReLU(SLOPE),
            nn.BatchNorm2d(outputs),
        )


def shortcut(inputs: int, outputs: int) -> nn.Sequential:
    """Return 1×1 convolution → LeakyReLU: (B, in, H, W) → (B, out, H, W)."""
    return nn.Sequential(nn.Conv2d(inputs, outputs, 1), nn.LeakyReLU(SLOPE))


class ContextBlock(nn.Module):
    """Local and wider context in parallel: s + dilated(local(s)), s = shortcut(x)."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.shortcut = shortcut(inputs, outputs)
        self.local = Unit(outputs, outputs, 3)
        self.dilated = Unit(outputs, outputs, 3, dilation=2)

    def forward(self, x: Tensor) -> Tensor:
        """Map (B, in, H, W) to (B, out, H, W)."""
        features = self.shortcut(x)
        return features + self.dilated(self.local(features))


class DilatedStack(nn.Module):
    """Receptive fields 3, 7 and 9 concatenated, then fused by a 1×1 unit."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.narrow = Unit(inputs, outputs, 3)
        self.middle = Unit(outputs, outputs, 3, dilation=2)
        self.wide = Unit(outputs, outputs, 2, dilation=2)
        self.fuse = Unit(3 * outputs, outputs, 1)

    def forward(self, x: Tensor) -> Tensor:
        """Map (B, in, H, W) to (B, out, H, W)."""
        narrow = self.narrow(x)
        middle = self.middle(narrow)
        wide = self.wide(middle)
        return self.fuse(torch.cat((narrow, middle, wide), dim=1))


class ResidualBlock(nn.Module):
    """Residual dilated block: shortcut(x) + stack(x)."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.shortcut = shortcut(inputs, outputs)
        self.stack = DilatedStack(inputs, outputs)

    def forward(self, x: Tensor) -> Tensor:
        """Map (B, in, H, W) to (B, out, H, W)."""
        return self.shortcut(x) + self.stack(x)


def average_pooling(dropout: float) -> nn.Sequential:
    """Return channel dropout → 3×3 average pooling: (B, C, H, W) → (B, C, H/2, W/2)."""
    return nn.Sequential(ChannelDropout(dropout), nn.AvgPool2d(3, stride=2, padding=1))


class UpBlock(nn.Module):
    """Pixel shuffle, concatenation of the skip connection, fusion; channel dropout after each."""

    def __init__(self, inputs: int, skip: int, outputs: int, dropout: float) -> None:
        super().__init__()
        self.upsampling = nn.PixelShuffle(2)
        self.dropout_upsampled = ChannelDropout(dropout)
        self.dropout_joined = ChannelDropout(dropout)
        self.stack = DilatedStack(inputs // 4 + skip, outputs)
        self.dropout_fused = ChannelDropout(dropout)

    def forward(self, x: Tensor, skip: Tensor) -> Tensor:
        """Map (B, in, H, W) and (B, skip, 2H, 2W) to (B, out, 2H, 2W)."""
        upsampled = self.dropout_upsampled(self.upsampling(x))
        joined = torch.cat((upsampled, skip), dim=1)
        return self.dropout_fused(self.stack(self.dropout_joined(joined)))
