# SPDX-License-Identifier: MIT
"""Designs of SalsaNext's family: both versions, and every rung from SalsaNet up to them.

Each rung of the papers' ladders (Table II) says only what differs from the one below it.
"""

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
    UpBlock,
    adding_3x3,
    concatenating_2x2,
    pixel_shuffle,
    replicating_3x3,
)

CONTEXT_WIDTH = 32
"""Channels of the context module."""


@dataclass(frozen=True, slots=True)
class Design:
    """Composition of a network of the family."""

    # Factories of the context module's blocks, from channels in and out; empty for none
    context: tuple[Stack, ...]
    widths: tuple[int, ...]  # Channels of the encoder's blocks, from the finest level to the bottom
    stack: Stack  # Factory of the path beside the shortcut of the encoder's blocks
    # Factory of dropout and pooling, from channels and dropout rate
    pooling: Callable[[int, float], nn.Module]
    # Factory of the decoder's blocks: from channels of the input, of the skip connection and of the
    # output, `fusing`, and dropout rate
    up_block: Callable[[int, int, int, Stack, float], UpBlock]
    # Channels of the decoder's blocks, from above the bottom to the finest level
    decoder_widths: tuple[int, ...]
    fusing: Stack  # Factory of the layers that fuse the joined channels in the decoder's blocks
    central: bool  # Leaves the first block and the last without dropout


SALSANET = Design(
    context=(),
    widths=(32, 64, 128, 256, 256),
    stack=partial(UnitChain, length=2),
    pooling=StridedDown,
    up_block=adding_3x3,
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
    up_block=concatenating_2x2,
    fusing=DilatedStack,
)
"""The paper does not say how its decoder is widened. Of the readings that keep its channels, this
is the nearest in parameters: transposed convolutions of 2×2 that keep the number of channels, the
skip connection concatenated, as with the pixel shuffle."""
SALSANEXT = replace(SALSANET_DILATED, up_block=pixel_shuffle, decoder_widths=(128, 128, 64, 32))

V1_LAYERS = replace(
    SALSANET,
    widths=(32, 64, 128, 256, 512, 512),
    up_block=replicating_3x3,
    decoder_widths=(512, 256, 128, 64, 32),
)
V1_CONTEXT = replace(V1_LAYERS, context=(PlainContextBlock,))
V1_DROPOUT = replace(V1_CONTEXT, central=True)
V1_POOLING = replace(V1_DROPOUT, pooling=lambda _, dropout: Down(dropout))
