# SPDX-License-Identifier: MIT
"""Assumed density filtering: a network that maps means and variances (paper III-C.1).

The network is not written a second time. A `Gaussian` stands in for a tensor, and every rule below
says what one function of the network does to it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self, TypeVar

import torch
import torch.nn.functional as F
from torch import Tensor

from salsanext_cli.uncertainty.moments import Groups, leaky_relu_moments, softmax_moments


@dataclass(frozen=True, slots=True, eq=False)
class Gaussian:
    """Independent Gaussians in place of a tensor's numbers.

    PyTorch asks such a stand-in what each function of a network does to it. A function without a
    rule is an error, so that the moments cannot drift apart from the network.
    """

    # From a function to what it does to moments (Gast & Roth 2018), with the same arguments
    RULES: ClassVar[Mapping[Callable[..., Any], Callable[..., Any]]] = {}

    mean: Tensor  # Of the same shape, dtype and device; the variance is not negative
    variance: Tensor

    def __post_init__(self) -> None:
        if self.mean.shape != self.variance.shape:
            found = f"mean {tuple(self.mean.shape)} and variance {tuple(self.variance.shape)}"
            raise ValueError(f"{found} differ in shape")

    @classmethod
    def __torch_function__(
        cls,
        function: Callable[..., Any],
        types: Sequence[type],
        args: Sequence[Any] = (),
        kwargs: dict[str, Any] | None = None,
    ) -> Any:
        """Apply the rule of a function; PyTorch calls this."""
        rule = cls.RULES.get(function)
        if rule is None:
            raise NotImplementedError(f"no rule for the moments of {function.__name__}")
        return rule(*args, **(kwargs or {}))

    @property
    def shape(self) -> torch.Size:
        """Shape of the mean."""
        return self.mean.shape

    @property
    def device(self) -> torch.device:
        """Device of the mean."""
        return self.mean.device

    def dim(self) -> int:
        """Return the number of dimensions."""
        return self.mean.dim()

    def like(self, mean: Tensor, variance: Tensor) -> Self:
        """Return other moments, of the same kind as these."""
        return type(self)(mean, variance)

    def __getitem__(self, index: Any) -> Self:
        return self.like(self.mean[index], self.variance[index])

    def __add__(self, other: Gaussian) -> Self:
        """Add independent Gaussians: Var = v₁ + v₂."""
        if not isinstance(other, Gaussian):
            return NotImplemented
        return self.like(self.mean + other.mean, self.variance + other.variance)

    def softmax(self, dim: int, groups: Groups | None = None) -> Self:
        """Return the moments of the softmax over a dimension, of classes merged into groups."""
        return self.like(*softmax_moments(self.mean, self.variance, dim, groups))


Kind = TypeVar("Kind", bound=Gaussian)


def propagate(network: Callable[..., Any], *inputs: Kind) -> Kind:
    """Run on Gaussians what is written for tensors."""
    outputs: Kind = network(*inputs)
    return outputs


def _linear(function: Callable[..., Tensor]) -> Callable[..., Gaussian]:
    """Return the rule of a convolution, transposed or not: Var = W² ∗ v."""

    def rule(
        x: Gaussian, weight: Tensor, bias: Tensor | None = None, *geometry: Any, **more: Any
    ) -> Gaussian:
        mean = function(x.mean, weight, bias, *geometry, **more)
        variance = function(x.variance, weight.square(), None, *geometry, **more)
        # Convolving by way of a transform can round a certain 0 to less.
        return x.like(mean, variance.clamp(min=0))

    return rule


def _batch_norm(
    x: Gaussian,
    running_mean: Tensor,
    running_var: Tensor,
    weight: Tensor,
    bias: Tensor,
    training: bool = False,
    momentum: float = 0.1,
    eps: float = 1e-5,
) -> Gaussian:
    """Var = v γ² / (σ² + ε), with the statistics that are stored."""
    if training:
        raise NotImplementedError("no rule for the moments of batch_norm in training")
    mean = F.batch_norm(x.mean, running_mean, running_var, weight, bias, False, momentum, eps)
    factor = weight.square() / (running_var + eps)
    return x.like(mean, x.variance * factor.view(1, -1, 1, 1))


def _leaky_relu(x: Gaussian, negative_slope: float = 0.01, inplace: bool = False) -> Gaussian:
    return x.like(*leaky_relu_moments(x.mean, x.variance, negative_slope))


def _avg_pool2d(x: Gaussian, kernel: int, stride: int, padding: int, *count: Any) -> Gaussian:
    """Var = Σv / k⁴, the mean of k² cells of which those outside are certain zeros."""
    if count not in ((), (False, True, None)):
        raise NotImplementedError(f"average pooling with {count}")
    variance = F.avg_pool2d(x.variance, kernel, stride, padding) / kernel**2
    return x.like(F.avg_pool2d(x.mean, kernel, stride, padding), variance)


def _dropout2d(x: Gaussian, p: float, training: bool, inplace: bool = False) -> Gaussian:
    """Change nothing: outside of training and sampling nothing is dropped."""
    if training:
        raise NotImplementedError("no rule for the moments of dropout2d in training")
    return x


def _concatenate(parts: Sequence[Gaussian], dim: int = 0) -> Gaussian:
    means, variances = zip(*((part.mean, part.variance) for part in parts), strict=True)
    return parts[0].like(torch.cat(means, dim), torch.cat(variances, dim))


def _pad(x: Gaussian, pad: Sequence[int], mode: str = "constant", value: Any = None) -> Gaussian:
    """Put certain values around, or move some there."""
    return x.like(F.pad(x.mean, pad, mode, value), F.pad(x.variance, pad, mode))


def _moved(function: Callable[..., Tensor]) -> Callable[..., Gaussian]:
    """Return the rule of a function that only moves numbers."""

    def rule(x: Gaussian, *args: Any, **kwargs: Any) -> Gaussian:
        return x.like(function(x.mean, *args, **kwargs), function(x.variance, *args, **kwargs))

    return rule


Gaussian.RULES = {
    F.conv2d: _linear(F.conv2d),
    F.conv_transpose2d: _linear(F.conv_transpose2d),
    F.batch_norm: _batch_norm,
    F.leaky_relu: _leaky_relu,
    F.avg_pool2d: _avg_pool2d,
    F.dropout2d: _dropout2d,
    F.pad: _pad,
    F.pixel_shuffle: _moved(F.pixel_shuffle),
    torch.softmax: Gaussian.softmax,
    torch.cat: _concatenate,
}
