# SPDX-License-Identifier: MIT
"""SalsaNext (arXiv 2003.03653, Figure 2) and its family: range image in, logits out."""

from itertools import pairwise

from torch import Tensor, nn

from salsanext_cli.network.blocks import ResidualBlock
from salsanext_cli.network.designs import CONTEXT_WIDTH, SALSANEXT, Design
from salsanext_cli.network.dropout import ChannelDropout
from salsanext_cli.network.segmentation import SegmentationNetwork, require_classes
from salsanext_cli.records import CHANNELS


class SalsaNext(SegmentationNetwork):
    """An encoder and a decoder; by default the second version, 6 711 572 parameters.

    `class_count`: c, including the unlabelled class 0; `dropout`: rate of the channel dropout, 0 ≤
    rate < 1; the paper trains with 0.2; `design`: its composition.
    """

    def __init__(
        self, class_count: int = 20, dropout: float = 0.2, design: Design = SALSANEXT
    ) -> None:
        super().__init__()
        require_classes(class_count)
        self.levels = len(design.decoder_widths)
        self.stride = (2**self.levels, 2**self.levels)
        # Blocks before the first dropout.
        self.trunk_blocks = 2 if design.central else 1
        # In this order, so that a seed goes on giving the weights that it gave.
        width = self._add_context(design)
        width = self._add_encoder(design, width, dropout)
        width = self._add_decoder(design, width, dropout)
        self.logits = nn.Conv2d(width, class_count, 1)

    def _add_context(self, design: Design) -> int:
        widths = [len(CHANNELS), *(CONTEXT_WIDTH for _ in design.context)]
        blocks = zip(design.context, pairwise(widths), strict=True)
        self.context = nn.Sequential(*(make(*channels) for make, channels in blocks))
        return widths[-1]

    def _add_encoder(self, design: Design, width: int, dropout: float) -> int:
        widths = (width, *design.widths)
        for number, channels in enumerate(pairwise(widths), 1):
            self.add_module(f"block{number}", ResidualBlock(*channels, design.stack))
        for number, outputs in enumerate(design.widths[:-1], 1):
            rate = dropout if number >= self.trunk_blocks else 0.0
            self.add_module(f"down{number}", design.pooling(outputs, rate))
        self.bottom = ChannelDropout(dropout)
        return widths[-1]

    def _add_decoder(self, design: Design, width: int, dropout: float) -> int:
        skips = reversed(design.widths[:-1])
        for number, (skip, outputs) in enumerate(zip(skips, design.decoder_widths, strict=True), 1):
            rate = 0.0 if design.central and number == self.levels else dropout
            block = design.up_block(width, skip, outputs, design.fusing, rate)
            self.add_module(f"up{number}", block)
            width = outputs
        return width

    def trunk(self, image: Tensor) -> tuple[Tensor, ...]:
        """Compute everything before the first dropout: the same for every Monte-Carlo pass.

        Takes (B, 5, H, W) with H and W divisible by `stride`; returns the features of the first
        block and, where the first level has no dropout, of the second: of the paper's second
        version (B, 64, H, W) and (B, 128, H/2, W/2).
        """
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
        features: Tensor = self.get_submodule(f"block{number}")(x)
        return features

    def _down(self, number: int, x: Tensor) -> Tensor:
        pooled: Tensor = self.get_submodule(f"down{number}")(x)
        return pooled
