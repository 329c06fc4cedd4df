# SPDX-License-Identifier: MIT
"""Channel dropout that can be sampled reproducibly at inference."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from salsanext_cli.core.errors import WeightsError

Draw = Callable[[int, float], Tensor]
"""Function of a number of channels and a rate, returns factors of the channels (B, C) float32."""
_DRAW: ContextVar[Draw | None] = ContextVar("_DRAW", default=None)


class ChannelDropout(nn.Module):
    """Drop whole channels with probability `rate`, scaling the rest by 1/(1 - rate)."""

    def __init__(self, rate: float) -> None:
        super().__init__()
        if not 0 <= rate < 1:
            raise ValueError(f"0 ≤ dropout < 1, not {rate}")
        self.rate = rate

    def forward(self, x: Tensor) -> Tensor:
        """Map (B, C, H, W) to the same shape."""
        draw = _DRAW.get()
        if draw is None or self.rate == 0:
            return F.dropout2d(x, self.rate, self.training)
        factors = draw(x.shape[1], self.rate)
        return x * factors.to(x.device, x.dtype)[:, :, None, None]


def dropouts(module: nn.Module) -> list[ChannelDropout]:
    """Return the dropout layers of a network with a rate above 0, in order of definition."""
    return [m for m in module.modules() if isinstance(m, ChannelDropout) and m.rate > 0]


def require_dropout(module: nn.Module) -> float:
    """Return the dropout rate; raise `WeightsError` if it is 0."""
    layers = dropouts(module)
    if not layers:
        expected = "a dropout rate above 0"
        hint = "run `salsanext tune dropout`"
        raise WeightsError("weights", "the network has no dropout", expected, hint)
    return layers[0].rate


def random_masks(generators: Sequence[torch.Generator]) -> Draw:
    """Return a function that draws the masks of Monte-Carlo passes, one CPU generator a pass."""

    def draw(channels: int, rate: float) -> Tensor:
        draws = torch.stack([torch.rand(channels, generator=g) for g in generators])
        return (draws >= rate).float() / (1 - rate)

    return draw


@contextmanager
def sampling(draw: Draw) -> Iterator[None]:
    """Multiply by the factors of a function in every dropout of this thread."""
    token = _DRAW.set(draw)
    try:
        yield
    finally:
        _DRAW.reset(token)
