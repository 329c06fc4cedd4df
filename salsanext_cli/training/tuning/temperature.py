# SPDX-License-Identifier: MIT
"""Temperature scaling (arXiv 1706.04599): one number that calibrates a softmax."""

import math
from collections.abc import Iterator

import torch
import torch.nn.functional as F
from torch import Tensor

CHUNK_POINTS = 1 << 16
"""Points whose logits are float64 at the same time."""


def negative_log_likelihood(logits: Tensor, truth: Tensor, temperature: float) -> float:
    """Return the mean of −log softmax(logits (N, C) / temperature) at the truth (N,), in nats."""
    exact = torch.tensor(temperature, dtype=torch.float64)
    losses = (_loss(part, own, exact, len(truth)) for part, own in chunks(logits, truth))
    return sum(loss.item() for loss in losses)


def best_temperature(logits: Tensor, truth: Tensor) -> float:
    """Return the temperature of the least negative log-likelihood of truth (N,) by logits (N, C).

    LBFGS on the logarithm of the temperature, in float64. The loss is convex in 1/temperature, so
    there is one minimum, or none above 0 and below infinity: 0 if the loss falls all the way down
    there, since every point is right; infinity if it falls all the way up, since the logits of the
    true classes are not above average.
    """
    own = logits.gather(1, truth[:, None])[:, 0]
    if (own == logits.amax(dim=1)).all():
        return 0.0
    if own.double().mean() <= logits.mean(dim=1).double().mean():
        return math.inf
    logarithm = torch.zeros((), dtype=torch.float64, requires_grad=True)
    search = torch.optim.LBFGS(
        [logarithm],
        max_iter=100,
        tolerance_grad=1e-8,
        tolerance_change=1e-12,
        line_search_fn="strong_wolfe",
    )

    def loss() -> float:
        search.zero_grad()
        total = 0.0
        for part, classes in chunks(logits, truth):
            # An exponential for each chunk: backward frees what it went through.
            share = _loss(part, classes, logarithm.exp(), len(truth))
            share.backward()  # type: ignore[no-untyped-call]
            total += share.item()
        return total

    search.step(loss)  # type: ignore[no-untyped-call]
    return math.exp(logarithm.item())


def chunks(logits: Tensor, truth: Tensor) -> Iterator[tuple[Tensor, Tensor]]:
    """Yield logits and classes of at most `CHUNK_POINTS` points at a time."""
    return zip(torch.split(logits, CHUNK_POINTS), torch.split(truth, CHUNK_POINTS), strict=True)


def _loss(logits: Tensor, truth: Tensor, temperature: Tensor, count: int) -> Tensor:
    return F.cross_entropy(logits.double() / temperature, truth, reduction="sum") / count
