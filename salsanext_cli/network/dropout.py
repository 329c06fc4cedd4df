# SPDX-License-Identifier: MIT
"""Channel dropout that can be sampled reproducibly at inference."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import torch
import torch.nn.functional as F
from torch import Tensor, nn


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
        self.generators: Sequence[torch.Generator] | None = None

    def forward(self, x: Tensor) -> Tensor:
        """Map (B, C, H, W) to the same shape."""
        if self.generators is None:
            return F.dropout2d(x, self.rate, self.training)
        draws = torch.stack([torch.rand(x.shape[1], generator=g) for g in self.generators])
        kept = (draws >= self.rate).to(x.dtype) / (1 - self.rate)
        return x * kept.to(x.device)[:, :, None, None]

    def extra_repr(self) -> str:
        """Describe the layer in the network's printout."""
        return f"rate={self.rate}"


def dropouts(module: nn.Module) -> list[ChannelDropout]:
    """Return the dropout layers of a network that drop anything, in order of definition."""
    return [m for m in module.modules() if isinstance(m, ChannelDropout) and m.rate > 0]


@contextmanager
def sampling(module: nn.Module, generators: Sequence[torch.Generator]) -> Iterator[None]:
    """Make every dropout of `module` draw from one generator per batch element.

    Batch norm is untouched: it stays frozen as long as the module is in evaluation mode.
    """
    layers = dropouts(module)
    for layer in layers:
        layer.generators = generators
    try:
        yield
    finally:
        for layer in layers:
            layer.generators = None
