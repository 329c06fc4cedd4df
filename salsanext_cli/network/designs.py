# SPDX-License-Identifier: MIT
"""Designs of SalsaNext's family: both versions, and every rung from SalsaNet up to them.

Each rung of the papers' ladders (Table II) says only what differs from the one below it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

from torch import nn

from salsanext_cli.network.blocks import (
    ContextBlock,
    DilatedStack,
    Down,
    PlainContextBlock,
    Stack,
    StridedDown,
    UnitChain,
)
from salsanext_cli.network.up_blocks import AddingUpBlock, TransposedUnit, UpBlock

CONTEXT_WIDTH = 32
"""Channels of the context module."""


@dataclass(frozen=True, slots=True)
class Upsampling:
    """Step of a decoder from one level to the next.

    Attributes
    ----------
    module : callable
        Makes the layer that doubles height and width, from the channels of its input and of the
        skip connection.
    joined : callable
        Channels after the skip connection is joined, from the same two numbers.
    block : type
        Up block, which joins.
    """

    module: Callable[[int, int], nn.Module]
    joined: Callable[[int, int], int]
    block: type[UpBlock]


PIXEL_SHUFFLE = Upsampling(
    lambda i, skip: nn.PixelShuffle(2), lambda i, skip: i // 4 + skip, UpBlock
)
TRANSPOSED = Upsampling(TransposedUnit.of_3x3, lambda i, skip: skip, AddingUpBlock)
TRANSPOSED_V1 = replace(TRANSPOSED, module=TransposedUnit.replicating)
TRANSPOSED_WIDE = Upsampling(
    lambda i, skip: TransposedUnit.of_2x2(i, i), lambda i, skip: i + skip, UpBlock
)


@dataclass(frozen=True, slots=True)
class Design:
    """Composition of a network of the family.

    Attributes
    ----------
    context : tuple of callable
        Factories of the context module's blocks, from channels in and out; empty for none.
    widths : tuple of int
        Channels of the encoder's blocks, from the finest level to the bottom.
    stack : callable
        Factory of the path beside the shortcut of the encoder's blocks.
    pooling : callable
        Factory of dropout and pooling, from channels and dropout rate.
    upsampling : Upsampling
        Step of the decoder.
    decoder_widths : tuple of int
        Channels of the decoder's blocks, from above the bottom to the finest level.
    fusing : callable
        Factory of the layers that fuse the joined channels in the decoder's blocks.
    central : bool
        Whether the first block and the last are without dropout.
    """

    context: tuple[Stack, ...]
    widths: tuple[int, ...]
    stack: Stack
    pooling: Callable[[int, float], nn.Module]
    upsampling: Upsampling
    decoder_widths: tuple[int, ...]
    fusing: Stack
    central: bool


SALSANET = Design(
    context=(),
    widths=(32, 64, 128, 256, 256),
    stack=partial(UnitChain, length=2),
    pooling=StridedDown,
    upsampling=TRANSPOSED,
    decoder_widths=(256, 128, 64, 32),
    fusing=partial(UnitChain, length=3),
    central=False,
)
SALSANET_CONTEXT = replace(SALSANET, context=3 * (ContextBlock,))
SALSANET_DROPOUT = replace(SALSANET_CONTEXT, central=True)
SALSANET_POOLING = replace(SALSANET_DROPOUT, pooling=lambda _, dropout: Down(dropout))
SALSANET_DILATED = replace(
    SALSANET_POOLING,
    widths=(64, 128, 256, 256, 256),
    stack=DilatedStack,
    upsampling=TRANSPOSED_WIDE,
    fusing=DilatedStack,
)
"""The paper does not say how its decoder is widened. Of the readings that keep its channels, this
is the nearest in parameters: transposed convolutions of 2×2 that keep the number of channels, the
skip connection concatenated, as with the pixel shuffle."""
SALSANEXT = replace(SALSANET_DILATED, upsampling=PIXEL_SHUFFLE, decoder_widths=(128, 128, 64, 32))

V1_LAYERS = replace(
    SALSANET,
    widths=(32, 64, 128, 256, 512, 512),
    upsampling=TRANSPOSED_V1,
    decoder_widths=(512, 256, 128, 64, 32),
)
V1_CONTEXT = replace(V1_LAYERS, context=(PlainContextBlock,))
V1_DROPOUT = replace(V1_CONTEXT, central=True)
V1_POOLING = replace(V1_DROPOUT, pooling=lambda _, dropout: Down(dropout))
