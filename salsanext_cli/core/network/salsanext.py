# SPDX-License-Identifier: MIT
"""SalsaNext (arXiv 2003.03653, III-B, Figure 2): range image in, logits out.

Every block is a plain composition of elementary modules, so that a network of variances can be
derived from it instead of written again.
"""

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn

from salsanext_cli.core.network.dropout import ChannelDropout
from salsanext_cli.core.network.segmentation import SegmentationNetwork
from salsanext_cli.core.records import CHANNELS

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


class SalsaNext(SegmentationNetwork):
    """Encoder and decoder with skip connections; 6 711 572 parameters with 20 classes.

    The first block and the last have no dropout (central dropout). Widths are the channels of the
    blocks: of the encoder from the finest level to the bottom, of the decoder back.
    """

    # It has the ranges of the image, whose small differences are the shape of things.
    precise = ("context",)

    def __init__(
        self,
        class_count: int = 20,
        dropout: float = 0.2,
        *,
        context_width: int = 32,
        widths: Sequence[int] = (64, 128, 256, 256, 256),
        decoder_widths: Sequence[int] = (128, 128, 64, 32),
    ) -> None:
        super().__init__()
        self.levels = len(decoder_widths)
        self.stride = (2**self.levels, 2**self.levels)
        self.context = nn.Sequential(
            ContextBlock(len(CHANNELS), context_width),
            ContextBlock(context_width, context_width),
            ContextBlock(context_width, context_width),
        )
        for number, (inputs, outputs) in enumerate(pairwise([context_width, *widths]), 1):
            self.add_module(f"block{number}", ResidualBlock(inputs, outputs))
        for number in range(1, self.levels + 1):
            self.add_module(f"down{number}", average_pooling(dropout if number > 1 else 0.0))
        self.bottom = ChannelDropout(dropout)
        width = widths[-1]
        skips = reversed(widths[:-1])
        for number, (skip, outputs) in enumerate(zip(skips, decoder_widths, strict=True), 1):
            rate = dropout if number < self.levels else 0.0
            self.add_module(f"up{number}", UpBlock(width, skip, outputs, rate))
            width = outputs
        self.logits = nn.Conv2d(width, class_count, 1)

    def trunk(self, image: Tensor) -> tuple[Tensor, ...]:
        """Map (B, 5, H, W) to the features (B, 64, H, W) and (B, 128, H/2, W/2) of two blocks."""
        first = self._module("block1", self.context(image))
        return first, self._module("block2", self._module("down1", first))

    def decoded(self, *features: Tensor) -> Tensor:
        """Compute the features of the last up block, (B, D, H, W), from the result of `trunk`."""
        skips = list(features)
        for level in range(len(skips), self.levels + 1):
            skips.append(self._module(f"block{level + 1}", self._module(f"down{level}", skips[-1])))
        upsampled: Tensor = self.bottom(skips.pop())
        for number in range(1, self.levels + 1):
            upsampled = self.get_submodule(f"up{number}")(upsampled, skips.pop())
        return upsampled

    def _module(self, name: str, x: Tensor) -> Tensor:
        return self.get_submodule(name)(x)
