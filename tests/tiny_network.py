# SPDX-License-Identifier: MIT
"""A network of a few hundred weights for tests of what is around a network."""

from torch import Tensor, nn

from salsanext_cli.network.dropout import ChannelDropout


class TinyNetwork(nn.Module):
    """Takes and returns what SalsaNext does, in a millisecond."""

    stride = (1, 1)

    def __init__(self, class_count: int = 20, dropout: float = 0.2) -> None:
        super().__init__()
        self.features = nn.Conv2d(5, 8, 3, padding=1)
        self.norm = nn.BatchNorm2d(8)
        self.dropout = ChannelDropout(dropout)
        self.logits = nn.Conv2d(8, class_count, 1)

    def forward(self, image: Tensor) -> Tensor:
        """Map (B, 5, H, W) to (B, C, H, W)."""
        logits: Tensor = self.logits(self.dropout(self.norm(self.features(image)).relu()))
        return logits
