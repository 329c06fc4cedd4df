# SPDX-License-Identifier: MIT
"""Assumed density filtering: a network that maps means and variances (paper III-C.1).

A `Gaussian` takes the place of a tensor in the unchanged network. Every rule below maps it through
one function of the network.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from salsanext_cli.core.compiled import parallel_for

NODES = 12  # Nodes of the Gauss-Hermite quadrature of the logistic function
CHUNK_SIZE = 1 << 15
"""Numbers per step on a CPU: too few for torch to share among threads, which would change bits."""
MAX_DEVIATIONS = 12.0
"""Standard deviations from the kink beyond which the other side changes no float64."""
MIN_DIVISOR = 1e-30  # Lower bound of divisors whose dividend is 0
DAMPING = 0.15
"""Damping of a second-order shift, so that it grows like √v for large v."""


def leaky_relu_moments(mean: Tensor, variance: Tensor, slope: float) -> tuple[Tensor, Tensor]:
    r"""Return mean and variance of LeakyReLU(x), x ~ N(m, v).

    With τ = \|m\|/√v, q = Q(τ) the mass beyond the kink and e = φ(τ) − τ q its mean excess::

        mean     = LeakyReLU(m) + (1 − a) √v e
        variance = v [a² + (1 − a²) p − (1 − a)² e (τ + e)]     p = 1 − q if m > 0, else q

    Nothing cancels, unlike in E[y²] − E[y]², which is 0 in float32 for m = 10, v = 10⁻⁶. Half
    precision is computed in float32.

    Parameters
    ----------
    mean : Tensor
        Mean m.
    variance : Tensor
        Variance v, of the same shape.
    slope : float
        Slope a below 0, from 0 to 1.

    Returns
    -------
    mean, variance : Tensor
        Moments of the result, of the same shape and dtype.
    """
    dtype = mean.dtype
    wide = torch.promote_types(mean.dtype, torch.float32)
    m = mean.to(wide)
    v = variance.to(wide)
    deviation = v.sqrt()
    far = m.abs().div_(deviation.clamp(min=MIN_DIVISOR)).clamp_(max=MAX_DEVIATIONS)
    beyond = torch.special.erfc(far * math.sqrt(0.5)).mul_(0.5)
    density = far.square().mul_(-0.5).exp_().mul_(1 / math.sqrt(2 * math.pi))
    excess = density.addcmul_(far, beyond, value=-1).clamp_(min=0)
    shifted = torch.where(m > 0, m, m * slope).addcmul_(deviation, excess, value=1 - slope)
    passed = torch.where(m > 0, 1 - beyond, beyond)
    lost = excess.mul_(far.add_(excess))
    share = passed.mul_(1 - slope**2).add_(slope**2).sub_(lost, alpha=(1 - slope) ** 2)
    return shifted.to(dtype), share.clamp_(min=0).mul_(v).to(dtype)


def softmax_moments(mean: Tensor, variance: Tensor, dim: int) -> tuple[Tensor, Tensor]:
    """Return mean and variance of the softmax of independent Gaussian logits.

    The softmax of class c is the logistic function of its logit minus the logarithm of the sum of
    the others' exponentials. That sum is taken as log-normal: with weights w, the softmax among
    the others, its logarithm has mean log Σ exp(m) + ½ Σ w (1 − w) v, damped, and variance
    Σ w² v. The moments of the logistic function of a Gaussian come from quadrature. The usual
    shortcut, a certain sum, makes the standard deviation of a confident class too large by a
    factor of hundreds.

    The means p are divided by their sum; each variance keeps its share of p (1 − p), which no
    variable between 0 and 1 exceeds. For variance 0, the means are the plain softmax.

    Parameters
    ----------
    mean : Tensor
        Means of the logits.
    variance : Tensor
        Their variances, of the same shape.
    dim : int
        Dimension of the classes.

    Returns
    -------
    mean, variance : Tensor
        Moments of the softmax, of the same shape and dtype.
    """
    wide = torch.promote_types(mean.dtype, torch.float32)
    m = mean.to(wide).movedim(dim, 0)
    v = variance.to(wide).movedim(dim, 0)
    on_cpu = m.device.type == "cpu"
    step = max(1, (CHUNK_SIZE if on_cpu else m.numel()) // len(m))
    mean_chunks = torch.split(m.reshape(len(m), -1), step, dim=1)
    variance_chunks = torch.split(v.reshape(len(v), -1), step, dim=1)
    means = list(mean_chunks)
    variances = list(variance_chunks)

    def compute(number: int) -> None:
        chunk_mean, chunk_variance = _softmax(mean_chunks[number], variance_chunks[number])
        means[number] = chunk_mean
        variances[number] = chunk_variance

    parallel_for(compute, range(len(means)))
    softmax_mean = torch.cat(means, dim=1).view(m.shape).movedim(0, dim)
    softmax_variance = torch.cat(variances, dim=1).view(m.shape).movedim(0, dim)
    return softmax_mean.to(mean.dtype), softmax_variance.to(mean.dtype)


def _softmax(m: Tensor, v: Tensor) -> tuple[Tensor, Tensor]:
    """Return the moments of (C, N)."""
    if len(m) == 1:
        return torch.ones_like(m), torch.zeros_like(v)
    nowhere = torch.zeros_like(m, dtype=torch.bool)
    is_best = nowhere.scatter_(0, m.argmax(0, keepdim=True), True)  # The largest of each column
    margin, margin_variance = _margins(m, v, is_best)
    probability, complement, variance = logistic_moments(margin, margin_variance)
    total = probability.sum(dim=0)
    others = _sum_of_others(probability, probability.masked_fill(is_best, 0), is_best)
    share = variance / complement.clamp(min=MIN_DIVISOR)
    mean = probability / total
    rest = others / total
    return mean, _consistent(mean, share * rest / total).minimum(mean * rest)


def logistic_moments(d: Tensor, variance: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return mean, 1 − mean and variance of the logistic function of N(d, variance)."""
    # Differences from the smaller of logistic(d) and 1 − logistic(d) keep the digits of a
    # confident class.
    near = -d.abs()
    deviation = variance.sqrt()
    small = torch.sigmoid(near)
    large = torch.sigmoid(-near)
    slope = small * large
    first = torch.zeros_like(d)
    second = torch.zeros_like(d)
    nodes, weights = np.polynomial.hermite_e.hermegauss(NODES)
    # The nodes are symmetric: one half gives steps up and down.
    half = slice(NODES // 2, None)
    pairs = zip(nodes[half].tolist(), (weights / weights.sum())[half].tolist(), strict=True)
    for node, weight in pairs:
        step = deviation * node
        decay = torch.expm1(-step).neg_()
        fall = slope * decay / (1 - small * decay)
        near_rise = slope * decay / (1 - large * decay)
        rise = torch.where(step < 1, near_rise, torch.sigmoid(near + step) - small)
        first.add_(rise - fall, alpha=weight)
        second.add_(rise.square_() + fall.square_(), alpha=weight)
    small = (small + first).clamp_(0, 1)
    large = (large - first).clamp_(0, 1)
    spread = (second - first.square()).clamp_(min=0)
    return torch.where(d > 0, large, small), torch.where(d > 0, small, large), spread


def _margins(m: Tensor, v: Tensor, is_best: Tensor) -> tuple[Tensor, Tensor]:
    """Return mean and variance of each logit minus log Σ exp of the others."""
    top = m.amax(dim=0, keepdim=True)
    shares = (m - top).exp()
    # The others of the best class are scaled by the second, because its share would hide theirs.
    rest = m.masked_fill(is_best, -math.inf)
    second = rest.amax(dim=0, keepdim=True)
    rest = (rest - second).exp()
    total = _sum_of_others(shares, rest, is_best)
    weighted = _sum_of_others(shares * v, rest * v, is_best) / total
    variance = _sum_of_others(shares.square() * v, rest.square() * v, is_best) / total.square()
    shift = 0.5 * (weighted - variance).clamp(min=0)
    margin = (m - torch.where(is_best, second, top)) - total.log()
    return margin - shift / (1 + DAMPING * shift).sqrt(), variance + v


def _consistent(mean: Tensor, variance: Tensor) -> Tensor:
    """Raise the variance of the likeliest class to a value consistent with the others.

    The classes sum to 1, so one cannot vary by more than all others together. Where it does, the
    log-normal sum has hidden its variance from the likeliest class.
    """
    deviation = variance.sqrt()
    largest, class_of_largest = deviation.max(dim=0, keepdim=True)
    lacking = (2 * largest - deviation.sum(dim=0, keepdim=True)).clamp(min=0)
    likeliest = mean.scatter(0, class_of_largest, -1.0).argmax(dim=0, keepdim=True)
    return deviation.scatter_add(0, likeliest, lacking).square()


def _sum_of_others(values: Tensor, rest: Tensor, is_best: Tensor) -> Tensor:
    """Return the sum over all classes but one, for each; `rest` has 0 for the best class."""
    others = values.sum(dim=0, keepdim=True) - values
    return torch.where(is_best, rest.sum(dim=0, keepdim=True), others).clamp_(min=0)


@dataclass(frozen=True, slots=True, eq=False)
class Gaussian:
    """Independent Gaussians in place of a tensor; a function without a rule raises an error.

    Mean and variance have the same shape, dtype and device. `RULES` maps functions to their effect
    on moments (Gast & Roth 2018), with the same arguments.
    """

    RULES: ClassVar[Mapping[Callable[..., Any], Callable[..., Any]]] = {}

    mean: Tensor
    variance: Tensor

    def __post_init__(self) -> None:
        if self.mean.shape != self.variance.shape:
            shapes = f"mean {tuple(self.mean.shape)} and variance {tuple(self.variance.shape)}"
            raise ValueError(f"{shapes} differ in shape")

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

    def __getitem__(self, index: Any) -> Gaussian:
        return Gaussian(self.mean[index], self.variance[index])

    def __add__(self, other: Gaussian) -> Gaussian:
        """Add independent Gaussians: Var = v₁ + v₂."""
        if not isinstance(other, Gaussian):
            return NotImplemented
        return Gaussian(self.mean + other.mean, self.variance + other.variance)

    def softmax(self, dim: int) -> Gaussian:
        """Return the moments of the softmax over a dimension."""
        mean, variance = softmax_moments(self.mean, self.variance, dim)
        return Gaussian(mean, variance)


def _linear(function: Callable[..., Tensor]) -> Callable[..., Gaussian]:
    """Return the rule of a convolution, transposed or not: Var = W² ∗ v."""

    def rule(
        x: Gaussian, weight: Tensor, bias: Tensor | None = None, *geometry: Any, **more: Any
    ) -> Gaussian:
        mean = function(x.mean, weight, bias, *geometry, **more)
        variance = function(x.variance, weight.square(), None, *geometry, **more)
        # Algorithms with a transform can round 0 to a negative number.
        return Gaussian(mean, variance.clamp(min=0))

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
    """Var = v γ² / (σ² + ε), with the stored statistics."""
    if training:
        raise NotImplementedError("no rule for the moments of batch_norm in training")
    mean = F.batch_norm(x.mean, running_mean, running_var, weight, bias, False, momentum, eps)
    factor = weight.square() / (running_var + eps)
    return Gaussian(mean, x.variance * factor.view(1, -1, 1, 1))


def _leaky_relu(x: Gaussian, negative_slope: float = 0.01, inplace: bool = False) -> Gaussian:
    mean, variance = leaky_relu_moments(x.mean, x.variance, negative_slope)
    return Gaussian(mean, variance)


def _avg_pool2d(x: Gaussian, kernel: int, stride: int, padding: int, *count: Any) -> Gaussian:
    """Var = Σv / k⁴, the mean of k² cells; padding consists of certain zeros."""
    if count not in ((), (False, True, None)):
        raise NotImplementedError(f"average pooling with {count}")
    variance = F.avg_pool2d(x.variance, kernel, stride, padding) / kernel**2
    return Gaussian(F.avg_pool2d(x.mean, kernel, stride, padding), variance)


def _dropout2d(x: Gaussian, p: float, training: bool, inplace: bool = False) -> Gaussian:
    """Return the input: nothing is dropped outside of training and sampling."""
    if training:
        raise NotImplementedError("no rule for the moments of dropout2d in training")
    return x


def _concatenate(gaussians: Sequence[Gaussian], dim: int = 0) -> Gaussian:
    means = [gaussian.mean for gaussian in gaussians]
    variances = [gaussian.variance for gaussian in gaussians]
    return Gaussian(torch.cat(means, dim), torch.cat(variances, dim))


def _pad(x: Gaussian, pad: Sequence[int], mode: str = "constant", value: Any = None) -> Gaussian:
    """Pad by certain values, or by values of the input."""
    return Gaussian(F.pad(x.mean, pad, mode, value), F.pad(x.variance, pad, mode))


def _pixel_shuffle(x: Gaussian, factor: int) -> Gaussian:
    return Gaussian(F.pixel_shuffle(x.mean, factor), F.pixel_shuffle(x.variance, factor))


Gaussian.RULES = {
    F.conv2d: _linear(F.conv2d),
    F.conv_transpose2d: _linear(F.conv_transpose2d),
    F.batch_norm: _batch_norm,
    F.leaky_relu: _leaky_relu,
    F.avg_pool2d: _avg_pool2d,
    F.dropout2d: _dropout2d,
    F.pad: _pad,
    F.pixel_shuffle: _pixel_shuffle,
    torch.softmax: Gaussian.softmax,
    torch.cat: _concatenate,
}
