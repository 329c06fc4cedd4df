# SPDX-License-Identifier: MIT
"""Channel dropout that can be sampled reproducibly at inference."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar

import torch
import torch.nn.functional as F
from torch import Tensor, nn

_GENERATORS: ContextVar[Sequence[torch.Generator] | None] = ContextVar("_GENERATORS", default=None)


class ChannelDropout(nn.Module):
    """Drop whole channels with probability `rate`, scaling the rest by 1/(1 - rate).

    In training mode the masks come from torch's global generator; inside `sampling` each element
    of the batch is one Monte-Carlo pass and draws its masks from its own generator, on the CPU,
    so that a pass does not depend on the device or on what else is in its batch.
    """

    def __init__(self, rate: float) -> None:
        super().__init__()
        if not 0 <= rate < 1:
            raise ValueError(f"a dropout rate in 0 ≤ rate < 1, not {rate}")
        self.rate = rate

    def forward(self, x: Tensor) -> Tensor:
        """Map (B, C, H, W) to the same shape."""
        generators = _GENERATORS.get()
        if generators is None or self.rate == 0:
            return F.dropout2d(x, self.rate, self.training)
        draws = torch.stack([torch.rand(x.shape[1], generator=g) for g in generators])
        kept = (draws >= self.rate).to(x.dtype) / (1 - self.rate)
        return x * kept.to(x.device)[:, :, None, None]

    def extra_repr(self) -> str:
        """Describe the layer in the network's printout."""
        return f"rate={self.rate}"


def dropouts(module: nn.Module) -> list[ChannelDropout]:
    """Return the dropout layers of a network that drop anything, in order of definition."""
    return [m for m in module.modules() if isinstance(m, ChannelDropout) and m.rate > 0]


@contextmanager
def sampling(generators: Sequence[torch.Generator]) -> Iterator[None]:
    """Make every dropout in this thread draw from one generator per batch element.

    Batch norm is untouched: it stays frozen as long as the module is in evaluation mode.
    """
    token = _GENERATORS.set(generators)
    try:
        yield
    finally:
        _GENERATORS.reset(token)
