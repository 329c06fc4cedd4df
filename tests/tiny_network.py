# SPDX-License-Identifier: MIT
"""A network of a few hundred weights for tests of what is around a network."""

from torch import Tensor, nn

from salsanext_cli.network.dropout import ChannelDropout
from salsanext_cli.network.segmentation import SegmentationNetwork


class TinyNetwork(SegmentationNetwork):
    """Takes and returns what SalsaNext does, in a millisecond."""

    stride = (1, 1)

    def __init__(self, class_count: int = 20, dropout: float = 0.2) -> None:
        super().__init__()
        self.features = nn.Conv2d(5, 8, 3, padding=1)
        self.norm = nn.BatchNorm2d(8)
        self.dropout = ChannelDropout(dropout)
        self.logits = nn.Conv2d(8, class_count, 1)

    def trunk(self, image: Tensor) -> tuple[Tensor, ...]:
        return (self.norm(self.features(image)).relu(),)

    def decoded(self, *features: Tensor) -> Tensor:
        return self.dropout(*features)
