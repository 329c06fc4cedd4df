# SPDX-License-Identifier: MIT
"""Networks of the papers' ablations (Table II), from SalsaNet up to SalsaNext.

Each network differs from the one above it in one design choice. The last step of either ablation
changes only the loss, so its network is that of the step before.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from salsanext_cli.core.network.dropout import ChannelDropout
from salsanext_cli.core.network.salsanext import (
    SLOPE,
    ContextBlock,
    DilatedStack,
    SalsaNext,
    Unit,
    average_pooling,
    shortcut,
)
from salsanext_cli.core.network.segmentation import SegmentationNetwork
from salsanext_cli.core.records import CHANNELS

Stack = Callable[[int, int], nn.Module]
"""Factory of a size-preserving part of a block, from its numbers of channels in and out."""


class UnitChain(nn.Sequential):
    """3×3 units in a row, as in a ResNet."""

    def __init__(self, inputs: int, outputs: int, length: int) -> None:
        widths = (inputs, *(length * [outputs]))
        super().__init__(*(Unit(a, b, 3) for a, b in pairwise(widths)))


TWO_UNITS, THREE_UNITS = (partial(UnitChain, length=length) for length in (2, 3))


class PlainContextBlock(nn.Module):
    """Context block of the paper's first version: shortcut(x) + two 3×3 units, not dilated."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.shortcut = shortcut(inputs, outputs)
        self.local = UnitChain(inputs, outputs, 2)

    def forward(self, x: Tensor) -> Tensor:
        """Map (B, in, H, W) to (B, out, H, W)."""
        return self.shortcut(x) + self.local(x)


class ResidualBlock(nn.Module):
    """shortcut(x) + stack(x)."""

    def __init__(self, inputs: int, outputs: int, stack: Stack) -> None:
        super().__init__()
        self.shortcut = shortcut(inputs, outputs)
        self.stack = stack(inputs, outputs)

    def forward(self, x: Tensor) -> Tensor:
        """Map (B, in, H, W) to (B, out, H, W)."""
        return self.shortcut(x) + self.stack(x)


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


def transposed_2x2(inputs: int, _: int) -> nn.ConvTranspose2d:
    """Return the upsampling of the dilated network, which preserves the number of channels."""
    return nn.ConvTranspose2d(inputs, inputs, 2, stride=2)


def transposed_3x3(inputs: int, skip: int) -> nn.ConvTranspose2d:
    """Return the upsampling of SalsaNet, into the channels of the skip connection."""
    return nn.ConvTranspose2d(inputs, skip, 3, stride=2, padding=1, output_padding=1)


@dataclass(frozen=True, slots=True)
class Design:
    """Composition of a network; the widths are those of `SalsaNext`, the functions are factories.

    Attributes
    ----------
    adds : bool
        Whether up blocks add the skip connection, instead of concatenating it.
    central : bool
        Whether the first block and the last have no dropout.
    """

    context: tuple[Stack, ...] = ()
    widths: tuple[int, ...] = (32, 64, 128, 256, 256)
    stack: Stack = TWO_UNITS
    pooling: Callable[[int, float], nn.Module] = strided_convolution
    upsampling: Callable[[int, int], nn.ConvTranspose2d] = transposed_3x3
    adds: bool = True
    decoder_widths: tuple[int, ...] = (256, 128, 64, 32)
    fusing: Stack = THREE_UNITS
    central: bool = False
    context_width: int = 32


class UpBlock(nn.Module):
    """Transposed convolution, addition or concatenation of the skip, fusion; dropout after each."""

    def __init__(
        self, design: Design, inputs: int, skip: int, outputs: int, dropout: float
    ) -> None:
        super().__init__()
        self.adds = design.adds
        upsampling = design.upsampling(inputs, skip)
        channels = upsampling.out_channels
        self.raising = nn.Sequential(upsampling, nn.LeakyReLU(SLOPE), nn.BatchNorm2d(channels))
        self.dropout_upsampled = ChannelDropout(dropout)
        self.dropout_joined = ChannelDropout(dropout)
        self.stack = design.fusing(skip if self.adds else channels + skip, outputs)
        self.dropout_fused = ChannelDropout(dropout)

    def forward(self, x: Tensor, skip: Tensor) -> Tensor:
        """Map (B, in, H, W) and (B, skip, 2H, 2W) to (B, out, 2H, 2W)."""
        upsampled = self.dropout_upsampled(self.raising(x))
        joined = upsampled + skip if self.adds else torch.cat((upsampled, skip), dim=1)
        return self.dropout_fused(self.stack(self.dropout_joined(joined)))


class Ladder(SalsaNext):
    """Network of an ablation."""

    def __init__(self, class_count: int = 20, dropout: float = 0.2, *, design: Design) -> None:
        SegmentationNetwork.__init__(self)
        self.levels, self.central = len(design.decoder_widths), design.central
        self.stride = (2**self.levels, 2**self.levels)
        widths = [len(CHANNELS), *(design.context_width for _ in design.context)]
        contexts = zip(design.context, pairwise(widths), strict=True)
        self.context = nn.Sequential(*(make(*channels) for make, channels in contexts))
        for number, channels in enumerate(pairwise((widths[-1], *design.widths)), 1):
            self.add_module(f"block{number}", ResidualBlock(*channels, design.stack))
        for number, outputs in enumerate(design.widths[:-1], 1):
            rate = 0.0 if design.central and number == 1 else dropout
            self.add_module(f"down{number}", design.pooling(outputs, rate))
        self.bottom = ChannelDropout(dropout)
        width, skips = design.widths[-1], reversed(design.widths[:-1])
        for number, (skip, outputs) in enumerate(zip(skips, design.decoder_widths, strict=True), 1):
            rate = 0.0 if design.central and number == self.levels else dropout
            self.add_module(f"up{number}", UpBlock(design, width, skip, outputs, rate))
            width = outputs
        self.logits = nn.Conv2d(width, class_count, 1)

    def trunk(self, image: Tensor) -> tuple[Tensor, ...]:
        """Compute the first block, and the second if the first level has no dropout."""
        if self.central:
            return super().trunk(image)
        return (self.get_submodule("block1")(self.context(image)),)


SALSANET = Design()
CONTEXT = replace(SALSANET, context=3 * (ContextBlock,))
DROPOUT = replace(CONTEXT, central=True)
POOLING = replace(DROPOUT, pooling=lambda _, dropout: average_pooling(dropout))
DILATED = replace(
    POOLING,
    widths=(64, 128, 256, 256, 256),
    stack=DilatedStack,
    upsampling=transposed_2x2,
    adds=False,
    fusing=DilatedStack,
)
"""The paper does not describe its decoder. Of the readings with the channels of the paper, this one
is the nearest in parameters: transposed convolutions of 2×2, the skip connection concatenated."""
V1_LAYERS = replace(
    SALSANET,
    widths=(32, 64, 128, 256, 512, 512),
    upsampling=ReplicatingConvTranspose2d,
    decoder_widths=(512, 256, 128, 64, 32),
)
V1_CONTEXT = replace(V1_LAYERS, context=(PlainContextBlock,))
V1_DROPOUT = replace(V1_CONTEXT, central=True)
V1_POOLING = replace(V1_DROPOUT, pooling=POOLING.pooling)

salsanet = partial(Ladder, design=SALSANET)
salsanet_context = partial(Ladder, design=CONTEXT)
salsanet_dropout = partial(Ladder, design=DROPOUT)
salsanet_pooling = partial(Ladder, design=POOLING)
salsanet_dilated = partial(Ladder, design=DILATED)
v1_layers = partial(Ladder, design=V1_LAYERS)
v1_context = partial(Ladder, design=V1_CONTEXT)
v1_dropout = partial(Ladder, design=V1_DROPOUT)
v1_pooling = partial(Ladder, design=V1_POOLING)
