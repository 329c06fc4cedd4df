# SPDX-License-Identifier: MIT
"""Building blocks of the encoders of SalsaNext and SalsaNet (paper III-B, Figure 2).

Every block is a plain composition of elementary modules, so that another view of the same
network, such as one that propagates variances, can be derived from it instead of written again.
"""

from collections.abc import Callable
from itertools import pairwise

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from salsanext_cli.network.dropout import ChannelDropout

SLOPE = 0.01
Stack = Callable[[int, int], nn.Module]
"""Factory of a size preserving part of a block, from its numbers of channels in and out."""


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
    """Local and wider context side by side: s + dilated(local(s)), s = shortcut(x)."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.shortcut = shortcut(inputs, outputs)
        self.local = Unit(outputs, outputs, 3)
        self.dilated = Unit(outputs, outputs, 3, dilation=2)

    def forward(self, x: Tensor) -> Tensor:
        """Map (B, in, H, W) to (B, out, H, W)."""
        features = self.shortcut(x)
        return features + self.dilated(self.local(features))


class PlainContextBlock(nn.Module):
    """The context of the paper's first version: s + second(first(x)), nothing dilated."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.shortcut = shortcut(inputs, outputs)
        self.local = UnitChain(inputs, outputs, 2)

    def forward(self, x: Tensor) -> Tensor:
        """Map (B, in, H, W) to (B, out, H, W)."""
        return self.shortcut(x) + self.local(x)


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


class UnitChain(nn.Sequential):
    """3×3 units in a row, as in a ResNet."""

    def __init__(self, inputs: int, outputs: int, length: int) -> None:
        widths = (inputs, *(length * [outputs]))
        super().__init__(*(Unit(a, b, 3) for a, b in pairwise(widths)))


class ResidualBlock(nn.Module):
    """shortcut(x) + stack(x), by default of dilated convolutions."""

    def __init__(self, inputs: int, outputs: int, stack: Stack = DilatedStack) -> None:
        super().__init__()
        self.shortcut = shortcut(inputs, outputs)
        self.stack = stack(inputs, outputs)

    def forward(self, x: Tensor) -> Tensor:
        """Map (B, in, H, W) to (B, out, H, W)."""
        return self.shortcut(x) + self.stack(x)


def average_pooling(_: int, dropout: float) -> nn.Sequential:
    """Return channel dropout → 3×3 average pooling: (B, C, H, W) → (B, C, H/2, W/2)."""
    return nn.Sequential(ChannelDropout(dropout), nn.AvgPool2d(3, stride=2, padding=1))


def strided_convolution(channels: int, dropout: float) -> nn.Sequential:
    """Return channel dropout → 3×3 convolution: (B, C, H, W) → (B, C, H/2, W/2)."""
    convolution = nn.Conv2d(channels, channels, 3, stride=2, padding=1)
    return nn.Sequential(ChannelDropout(dropout), convolution)


class ReplicatingConvTranspose2d(nn.ConvTranspose2d):
    """Transposed 3×3 convolution, (H, W) to (2H − 1, 2W − 1), last row and column repeated."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__(inputs, outputs, 3, stride=2, padding=1)

    def forward(self, x: Tensor, output_size: list[int] | None = None) -> Tensor:
        """Map (B, in, H, W) to (B, out, 2H, 2W)."""
        return F.pad(super().forward(x, output_size), (0, 1, 0, 1), mode="replicate")


def transposed_unit(convolution: nn.ConvTranspose2d) -> nn.Sequential:
    """Return convolution → LeakyReLU → batch norm: (B, in, H, W) → (B, out, 2H, 2W)."""
    norm = nn.BatchNorm2d(convolution.out_channels)
    return nn.Sequential(convolution, nn.LeakyReLU(SLOPE), norm)


class UpBlock(nn.Module):
    """Upsample ×2, concatenate or add the skip connection, fuse; channel dropout around each."""

    def __init__(
        self,
        upsampling: nn.Module,
        joined: int,
        outputs: int,
        stack: Stack,
        dropout: float,
        *,
        adds: bool = False,
    ) -> None:
        super().__init__()
        self.adds = adds
        # The attributes' names are those in weights files.
        self.raising = upsampling
        self.dropout_raised = ChannelDropout(dropout)
        self.dropout_joined = ChannelDropout(dropout)
        self.stack = stack(joined, outputs)
        self.dropout_fused = ChannelDropout(dropout)

    def forward(self, x: Tensor, skip: Tensor) -> Tensor:
        """Map (B, in, H, W) and (B, skip, 2H, 2W) to (B, out, 2H, 2W)."""
        upsampled = self.dropout_raised(self.raising(x))
        joined = upsampled + skip if self.adds else torch.cat((upsampled, skip), dim=1)
        return self.dropout_fused(self.stack(self.dropout_joined(joined)))


def pixel_shuffle(inputs: int, skip: int, outputs: int, stack: Stack, dropout: float) -> UpBlock:
    """Return an up block of a pixel shuffle and a concatenation."""
    return UpBlock(nn.PixelShuffle(2), inputs // 4 + skip, outputs, stack, dropout)


def concatenating_2x2(
    inputs: int, skip: int, outputs: int, stack: Stack, dropout: float
) -> UpBlock:
    """Return an up block of a transposed convolution of kernel 2×2 and a concatenation."""
    unit = transposed_unit(nn.ConvTranspose2d(inputs, inputs, 2, 2))
    return UpBlock(unit, inputs + skip, outputs, stack, dropout)


def adding_3x3(inputs: int, skip: int, outputs: int, stack: Stack, dropout: float) -> UpBlock:
    """Return an up block of a transposed convolution of kernel 3×3 and an addition."""
    unit = transposed_unit(nn.ConvTranspose2d(inputs, skip, 3, 2, padding=1, output_padding=1))
    return UpBlock(unit, skip, outputs, stack, dropout, adds=True)


def replicating_3x3(inputs: int, skip: int, outputs: int, stack: Stack, dropout: float) -> UpBlock:
    """Return an up block as `adding_3x3` does, the last row and column repeated."""
    unit = transposed_unit(ReplicatingConvTranspose2d(inputs, skip))
    return UpBlock(unit, skip, outputs, stack, dropout, adds=True)
