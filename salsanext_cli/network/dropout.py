# SPDX-License-Identifier: MIT
"""Channel dropout that can be sampled reproducibly at inference."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from salsanext_cli.errors import WeightsError

Draw = Callable[[int, float], Tensor]
"""Function of a number of channels and a rate: factors of the channels, (B, C) float32."""
_DRAW: ContextVar[Draw | None] = ContextVar("_DRAW", default=None)


class ChannelDropout(nn.Module):
    """Drop whole channels with probability `rate`, scaling the rest by 1/(1 - rate)."""

    def __init__(self, rate: float) -> None:
        super().__init__()
        if not 0 <= rate < 1:
            raise ValueError(f"a dropout rate in 0 ≤ rate < 1, not {rate}")
        self.rate = rate

    def forward(self, x: Tensor) -> Tensor:
        """Map (B, C, H, W) to the same shape."""
        draw = _DRAW.get()
        if draw is None or self.rate == 0:
            return F.dropout2d(x, self.rate, self.training)
        factors = draw(x.shape[1], self.rate)
        return x * factors.to(x.device, x.dtype)[:, :, None, None]


def dropouts(module: nn.Module) -> list[ChannelDropout]:
    """Return the dropout layers of a network that drop anything, in order of definition."""
    return [m for m in module.modules() if isinstance(m, ChannelDropout) and m.rate > 0]


def require_dropout(module: nn.Module) -> float:
    """Return the dropout rate; `WeightsError` for a network that drops nothing."""
    if not (layers := dropouts(module)):
        expected, hint = "a dropout rate above 0", "`salsanext tune dropout` finds one"
        raise WeightsError("weights", "a network without dropout", expected, hint)
    return layers[0].rate


def random_masks(generators: Sequence[torch.Generator]) -> Draw:
    """Return a function that draws the masks of each Monte-Carlo pass by its own CPU generator."""

    def draw(channels: int, rate: float) -> Tensor:
        draws = torch.stack([torch.rand(channels, generator=g) for g in generators])
        return (draws >= rate).float() / (1 - rate)

    return draw


@contextmanager
def sampling(draw: Draw) -> Iterator[None]:
    """Make every dropout in this thread multiply by what a function gives; batch norm stays."""
    token = _DRAW.set(draw)
    try:
        yield
    finally:
        _DRAW.reset(token)
