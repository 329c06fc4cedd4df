# SPDX-License-Identifier: MIT
"""SalsaNext (arXiv 2003.03653, Figure 2) and its family: range image in, logits out.

Both versions, and every rung of the papers' ladders (Table II) from SalsaNet up to them, are one
module in several designs; each says only what differs from the rung below it.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

from torch import Tensor, nn

from salsanext_cli.network import blocks
from salsanext_cli.network.blocks import DilatedStack, Stack, UnitChain
from salsanext_cli.network.dropout import ChannelDropout
from salsanext_cli.network.segmentation import SegmentationNetwork
from salsanext_cli.records import CHANNELS

CONTEXT_WIDTH = 32  # Channels of the context module


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
    up_block: Callable[[int, int, int, Stack, float], blocks.UpBlock]
    # Channels of the decoder's blocks, from above the bottom to the finest level
    decoder_widths: tuple[int, ...]
    fusing: Stack  # Factory of the layers that fuse the joined channels in the decoder's blocks
    central: bool  # Leaves the first block and the last without dropout


SALSANET = Design(
    context=(),
    widths=(32, 64, 128, 256, 256),
    stack=partial(UnitChain, length=2),
    pooling=blocks.strided_convolution,
    up_block=blocks.adding_3x3,
    decoder_widths=(256, 128, 64, 32),
    fusing=partial(UnitChain, length=3),
    central=False,
)
SALSANET_CONTEXT = replace(SALSANET, context=3 * (blocks.ContextBlock,))
SALSANET_DROPOUT = replace(SALSANET_CONTEXT, central=True)
SALSANET_POOLING = replace(SALSANET_DROPOUT, pooling=blocks.average_pooling)
SALSANET_DILATED = replace(
    SALSANET_POOLING,
    widths=(64, 128, 256, 256, 256),
    stack=DilatedStack,
    up_block=blocks.concatenating_2x2,
    fusing=DilatedStack,
)
"""The paper does not say how its decoder is widened. Of the readings that keep its channels, this
is the nearest in parameters: transposed convolutions of 2×2 that keep the number of channels, the
skip connection concatenated, as with the pixel shuffle."""
SALSANEXT = replace(
    SALSANET_DILATED, up_block=blocks.pixel_shuffle, decoder_widths=(128, 128, 64, 32)
)

V1_LAYERS = replace(
    SALSANET,
    widths=(32, 64, 128, 256, 512, 512),
    up_block=blocks.replicating_3x3,
    decoder_widths=(512, 256, 128, 64, 32),
)
V1_CONTEXT = replace(V1_LAYERS, context=(blocks.PlainContextBlock,))
V1_DROPOUT = replace(V1_CONTEXT, central=True)
V1_POOLING = replace(V1_DROPOUT, pooling=blocks.average_pooling)


class SalsaNext(SegmentationNetwork):
    """An encoder and a decoder; by default the second version, 6 711 572 parameters."""

    def __init__(
        self, class_count: int = 20, dropout: float = 0.2, design: Design = SALSANEXT
    ) -> None:
        super().__init__()
        self.levels = len(design.decoder_widths)
        self.stride = (2**self.levels, 2**self.levels)
        # Blocks before the first dropout.
        self.trunk_blocks = 2 if design.central else 1
        # In this order, so that a seed goes on giving the weights that it gave.
        widths = [len(CHANNELS), *(CONTEXT_WIDTH for _ in design.context)]
        contexts = zip(design.context, pairwise(widths), strict=True)
        self.context = nn.Sequential(*(make(*channels) for make, channels in contexts))
        for number, channels in enumerate(pairwise((widths[-1], *design.widths)), 1):
            self.add_module(f"block{number}", blocks.ResidualBlock(*channels, design.stack))
        for number, outputs in enumerate(design.widths[:-1], 1):
            rate = dropout if number >= self.trunk_blocks else 0.0
            self.add_module(f"down{number}", design.pooling(outputs, rate))
        self.bottom = ChannelDropout(dropout)
        width, skips = design.widths[-1], reversed(design.widths[:-1])
        for number, (skip, outputs) in enumerate(zip(skips, design.decoder_widths, strict=True), 1):
            rate = 0.0 if design.central and number == self.levels else dropout
            up_block = design.up_block(width, skip, outputs, design.fusing, rate)
            self.add_module(f"up{number}", up_block)
            width = outputs
        self.logits = nn.Conv2d(width, class_count, 1)

    def trunk(self, image: Tensor) -> tuple[Tensor, ...]:
        """Compute the first block, and the second if level 1 has no dropout."""
        # Of (B, 5, H, W): in the paper's second version (B, 64, H, W) and (B, 128, H/2, W/2).
        features = [self._block(1, self.context(image))]
        if self.trunk_blocks == 2:
            features.append(self._block(2, self._down(1, features[0])))
        return tuple(features)

    def decoded(self, *features: Tensor) -> Tensor:
        """Compute the features of the last up block, (B, D, H, W), from what `trunk` returns."""
        skips = list(features)
        for level in range(self.trunk_blocks, self.levels + 1):
            skips.append(self._block(level + 1, self._down(level, skips[-1])))
        upsampled: Tensor = self.bottom(skips.pop())
        for number in range(1, self.levels + 1):
            upsampled = self.get_submodule(f"up{number}")(upsampled, skips.pop())
        return upsampled

    def _block(self, number: int, x: Tensor) -> Tensor:
        return self.get_submodule(f"block{number}")(x)

    def _down(self, number: int, x: Tensor) -> Tensor:
        return self.get_submodule(f"down{number}")(x)
