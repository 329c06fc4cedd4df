# SPDX-License-Identifier: MIT
"""The building blocks of the decoders: raise, join the skip connection, fuse (paper III-B)."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from salsanext_cli.network.blocks import SLOPE, Stack
from salsanext_cli.network.dropout import ChannelDropout


class TransposedUnit(nn.Sequential):
    """Transposed convolution ×2 → LeakyReLU → batch norm: (B, in, H, W) → (B, out, 2H, 2W)."""

    def __init__(self, inputs: int, outputs: int, kernel: int = 3) -> None:
        margin = kernel - 2
        super().__init__(
            nn.ConvTranspose2d(
                inputs, outputs, kernel, stride=2, padding=margin, output_padding=margin
            ),
            nn.LeakyReLU(SLOPE),
            nn.BatchNorm2d(outputs),
        )


class UpBlock(nn.Module):
    """Raise ×2, join the skip connection, fuse; channel dropout around each.

    Parameters
    ----------
    raising : Module
        (B, in, H, W) to (B, raised, 2H, 2W).
    joined, outputs : int
        Channels after the join and of the block.
    stack : callable
        Makes what fuses the joined channels.
    dropout : float
        Rate.
    """

    def __init__(
        self, raising: nn.Module, joined: int, outputs: int, stack: Stack, dropout: float
    ) -> None:
        super().__init__()
        self.raising = raising
        self.dropout_raised = ChannelDropout(dropout)
        self.dropout_joined = ChannelDropout(dropout)
        self.stack = stack(joined, outputs)
        self.dropout_fused = ChannelDropout(dropout)

    def forward(self, x: Tensor, skip: Tensor) -> Tensor:
        """Map (B, in, H, W) and (B, skip, 2H, 2W) to (B, out, 2H, 2W)."""
        joined = self.join(self.dropout_raised(self.raising(x)), skip)
        raised: Tensor = self.dropout_fused(self.stack(self.dropout_joined(joined)))
        return raised

    def join(self, raised: Tensor, skip: Tensor) -> Tensor:
        """Put both side by side."""
        return torch.cat((raised, skip), dim=1)


class AddingUpBlock(UpBlock):
    """An up block that adds the skip connection, of as many channels as what was raised."""

    def join(self, raised: Tensor, skip: Tensor) -> Tensor:
        """Add."""
        return raised + skip
