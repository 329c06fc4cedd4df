# SPDX-License-Identifier: MIT
"""Building blocks of the decoders: upsample, join the skip connection, fuse (paper III-B)."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from salsanext_cli.network.blocks import SLOPE, Stack
from salsanext_cli.network.dropout import ChannelDropout


class ReplicatingConvTranspose2d(nn.ConvTranspose2d):
    """Transposed 3×3 convolution ×2 of the paper's first version.

    The convolution makes (2H − 1, 2W − 1) of (H, W); its last row and column are repeated.
    """

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__(inputs, outputs, 3, stride=2, padding=1)

    def forward(self, x: Tensor, output_size: list[int] | None = None) -> Tensor:
        """Map (B, in, H, W) to (B, out, 2H, 2W)."""
        return F.pad(super().forward(x, output_size), (0, 1, 0, 1), mode="replicate")


class TransposedUnit(nn.Sequential):
    """Transposed convolution ×2 → LeakyReLU → batch norm: (B, in, H, W) → (B, out, 2H, 2W)."""

    def __init__(self, convolution: nn.ConvTranspose2d) -> None:
        norm = nn.BatchNorm2d(convolution.out_channels)
        super().__init__(convolution, nn.LeakyReLU(SLOPE), norm)


class UpBlock(nn.Module):
    """Upsample ×2, concatenate the skip connection, fuse; channel dropout around each.

    `upsampling`: (B, in, H, W) to (B, upsampled, 2H, 2W); `joined`, `outputs`: channels after the
    concatenation, and of the block; `stack`: factory of the layers that fuse, from these two
    numbers; `dropout`: rate.
    """

    def __init__(
        self, upsampling: nn.Module, joined: int, outputs: int, stack: Stack, dropout: float
    ) -> None:
        super().__init__()
        # The attributes' names are those in weights files.
        self.raising = upsampling
        self.dropout_raised = ChannelDropout(dropout)
        self.dropout_joined = ChannelDropout(dropout)
        self.stack = stack(joined, outputs)
        self.dropout_fused = ChannelDropout(dropout)

    def forward(self, x: Tensor, skip: Tensor) -> Tensor:
        """Map (B, in, H, W) and (B, skip, 2H, 2W) to (B, out, 2H, 2W)."""
        joined = self.join(self.dropout_raised(self.raising(x)), skip)
        fused: Tensor = self.dropout_fused(self.stack(self.dropout_joined(joined)))
        return fused

    def join(self, upsampled: Tensor, skip: Tensor) -> Tensor:
        """Concatenate."""
        return torch.cat((upsampled, skip), dim=1)


class AddingUpBlock(UpBlock):
    """Up block that adds the skip connection, which has as many channels."""

    def join(self, upsampled: Tensor, skip: Tensor) -> Tensor:
        """Add."""
        return upsampled + skip


def pixel_shuffle(inputs: int, skip: int, outputs: int, stack: Stack, dropout: float) -> UpBlock:
    """Return an up block of a pixel shuffle and a concatenation."""
    return UpBlock(nn.PixelShuffle(2), inputs // 4 + skip, outputs, stack, dropout)


def concatenating_2x2(
    inputs: int, skip: int, outputs: int, stack: Stack, dropout: float
) -> UpBlock:
    """Return an up block of a transposed convolution of kernel 2×2 and a concatenation."""
    unit = TransposedUnit(nn.ConvTranspose2d(inputs, inputs, 2, 2))
    return UpBlock(unit, inputs + skip, outputs, stack, dropout)


def adding_3x3(inputs: int, skip: int, outputs: int, stack: Stack, dropout: float) -> UpBlock:
    """Return an up block of a transposed convolution of kernel 3×3 and an addition."""
    unit = TransposedUnit(nn.ConvTranspose2d(inputs, skip, 3, 2, padding=1, output_padding=1))
    return AddingUpBlock(unit, skip, outputs, stack, dropout)


def replicating_3x3(inputs: int, skip: int, outputs: int, stack: Stack, dropout: float) -> UpBlock:
    """Return an up block as `adding_3x3` does, the last row and column repeated."""
    unit = TransposedUnit(ReplicatingConvTranspose2d(inputs, skip))
    return AddingUpBlock(unit, skip, outputs, stack, dropout)
