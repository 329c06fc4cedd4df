# SPDX-License-Identifier: MIT
"""The designs of SalsaNext's family: both versions, and every rung from SalsaNet up to them.

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
class Raising:
    """How a decoder gets from one level to the next.

    Attributes
    ----------
    module : callable
        Makes what doubles height and width, from channels in and those of the skip connection.
    joined : callable
        The channels in a block after the join, from the same two numbers.
    block : callable
        The kind of up block, which joins.
    """

    module: Callable[[int, int], nn.Module]
    joined: Callable[[int, int], int]
    block: type[UpBlock]


SHUFFLING = Raising(lambda inputs, skip: nn.PixelShuffle(2), lambda i, skip: i // 4 + skip, UpBlock)
ADDING = Raising(TransposedUnit, lambda inputs, skip: skip, AddingUpBlock)
KEEPING = Raising(
    lambda inputs, skip: TransposedUnit(inputs, inputs, kernel=2),
    lambda inputs, skip: inputs + skip,
    UpBlock,
)


@dataclass(frozen=True, slots=True)
class Design:
    """What a network of the family is made of.

    Attributes
    ----------
    context : tuple of callable
        What makes each block of the context module; empty for none.
    widths : tuple of int
        Channels of the encoder's blocks, from the finest level to the bottom.
    stack : callable
        What lies beside the shortcut of the encoder's blocks.
    pooling : callable
        What makes the way down, from channels and dropout rate.
    raising : Raising
        The way up.
    raised : tuple of int
        Channels of the decoder's blocks, from above the bottom to the finest level.
    fusing : callable
        What fuses the joined channels in the decoder's blocks.
    central : bool
        Whether the first block and the last are without dropout.
    """

    context: tuple[Stack, ...]
    widths: tuple[int, ...]
    stack: Stack
    pooling: Callable[[int, float], nn.Module]
    raising: Raising
    raised: tuple[int, ...]
    fusing: Stack
    central: bool


def _average(channels: int, dropout: float) -> nn.Module:
    return Down(dropout)


SALSANET = Design(
    context=(),
    widths=(32, 64, 128, 256, 256),
    stack=partial(UnitChain, length=2),
    pooling=StridedDown,
    raising=ADDING,
    raised=(256, 128, 64, 32),
    fusing=partial(UnitChain, length=3),
    central=False,
)
SALSANET_CONTEXT = replace(SALSANET, context=3 * (ContextBlock,))
SALSANET_DROPOUT = replace(SALSANET_CONTEXT, central=True)
SALSANET_POOLING = replace(SALSANET_DROPOUT, pooling=_average)
SALSANET_DILATED = replace(
    SALSANET_POOLING,
    widths=(64, 128, 256, 256, 256),
    stack=DilatedStack,
    raising=KEEPING,
    fusing=DilatedStack,
)
"""The paper does not say how its decoder is widened. Of the readings that keep its channels, this
is the nearest in parameters: transposed convolutions of 2×2 that keep what comes in, the skip
connections beside it, as the pixel shuffle has them."""
SALSANEXT = replace(SALSANET_DILATED, raising=SHUFFLING, raised=(128, 128, 64, 32))

V1_LAYERS = replace(SALSANET, widths=(32, 64, 128, 256, 512, 512), raised=(512, 256, 128, 64, 32))
V1_CONTEXT = replace(V1_LAYERS, context=(PlainContextBlock,))
V1_DROPOUT = replace(V1_CONTEXT, central=True)
V1_POOLING = replace(V1_DROPOUT, pooling=_average)
