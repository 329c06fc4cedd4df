# SPDX-License-Identifier: MIT
"""Functions of moments whose derivatives are written down, not recorded step by step.

A recording keeps everything between input and output, divides by deviations that may be 0, and
forbids working in place. A function that is written down keeps its inputs.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from torch import Tensor
from torch.autograd import Function
from torch.autograd.function import once_differentiable

Tensors = tuple[Tensor, ...]


class _Known(Function):
    @staticmethod
    def forward(
        ctx: Any,
        mean: Tensor,
        variance: Tensor,
        function: Callable[[Tensor, Tensor], Tensors],
        back: Callable[..., tuple[Tensor, Tensor]],
    ) -> Tensors:
        ctx.save_for_backward(mean, variance)
        ctx.back = back
        return function(mean, variance)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, Tensor, None, None]:
        return *ctx.back(*ctx.saved_tensors, *gradients), None, None


def differentiable(
    function: Callable[[Tensor, Tensor], Tensors],
    back: Callable[..., tuple[Tensor, Tensor]],
    mean: Tensor,
    variance: Tensor,
) -> Tensors:
    """Apply a function of means and variances so that gradients flow back by another.

    Parameters
    ----------
    function : callable
        From mean and variance to any number of tensors.
    back : callable
        From mean, variance and the gradients of these tensors to those of mean and variance.
    mean, variance : Tensor
    """
    results: Tensors = _Known.apply(mean, variance, function, back)  # type: ignore[no-untyped-call]
    return results
