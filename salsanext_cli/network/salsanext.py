# SPDX-License-Identifier: MIT
"""SalsaNext (arXiv 2003.03653, Figure 2): range image in, logits out."""

from collections.abc import Sequence
from itertools import pairwise

from torch import Tensor, nn

from salsanext_cli.network.blocks import ContextBlock, ResidualBlock, UpBlock, average_pooling
from salsanext_cli.network.dropout import ChannelDropout
from salsanext_cli.network.segmentation import SegmentationNetwork
from salsanext_cli.records import CHANNELS


class SalsaNext(SegmentationNetwork):
    """Encoder and decoder with skip connections; 6 711 572 parameters with 20 classes.

    Parameters
    ----------
    class_count : int
        Number of classes.
    dropout : float
        Rate of all dropouts; the first block and the last have none (central dropout).
    context_width : int
        Channels of the context module.
    widths : sequence of int
        Channels of the encoder's blocks, from the finest level to the bottom.
    decoder_widths : sequence of int
        Channels of the decoder's blocks, from above the bottom to the finest level.
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
        channels = pairwise((len(CHANNELS), *(3 * [context_width])))
        self.context = nn.Sequential(*(ContextBlock(*pair) for pair in channels))
        for number, pair in enumerate(pairwise((context_width, *widths)), 1):
            self.add_module(f"block{number}", ResidualBlock(*pair))
        for number in range(1, self.levels + 1):
            self.add_module(f"down{number}", average_pooling(dropout if number > 1 else 0.0))
        self.bottom = ChannelDropout(dropout)
        width, skips = widths[-1], reversed(widths[:-1])
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
