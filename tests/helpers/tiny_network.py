# SPDX-License-Identifier: MIT
"""A network of a few hundred weights for tests of what is around a network."""

import torch
from torch import Tensor, nn

from salsanext_cli.core.network.dropout import ChannelDropout
from salsanext_cli.core.network.segmentation import SegmentationNetwork
from salsanext_cli.training.learner import Learner
from salsanext_cli.training.recipe import Recipe

CLASS_WEIGHTS = torch.tensor([0.0, 1.0, 2.0])


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


def learner(device: str = "cpu", **changes: object) -> Learner:
    """Return a learner of a tiny network of three classes, the same on every device."""
    recipe = Recipe(batch=2, warm_up=0.0).with_changes(**changes)
    with torch.random.fork_rng():
        torch.manual_seed(0)
        module = TinyNetwork(3, dropout=recipe.dropout)
    return Learner(module, recipe, CLASS_WEIGHTS, torch.device(device))


def batch(seed: int = 0) -> tuple[Tensor, Tensor]:
    """Return images and, for each pixel, which of two classes it is of."""
    images = torch.randn(2, 5, 16, 32, generator=torch.Generator().manual_seed(seed))
    return images, (images[:, 0] > 0).byte() + 1
