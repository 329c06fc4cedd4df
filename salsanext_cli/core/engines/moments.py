# SPDX-License-Identifier: MIT
"""Sums of the softmax over passes or noisy copies, in float64 for an exact variance."""

from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from salsanext_cli.core.classes.merging import ClassMerging
from salsanext_cli.core.compiled import argument, compiled, parallel_for_slices
from salsanext_cli.core.records import Double, Float

Values = TypeVar("Values", Float, Double)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SoftmaxSpread:
    """Mean and spread of the softmax over passes, float32.

    Attributes
    ----------
    mean, variance : (C, H, W) float32
        Mean, and variance of the population (paper III-C.2).
    epistemic : (H, W) float32
        Mean over classes of the variance.
    entropy : (H, W) float32
        Entropy of the mean in nats.
    mutual_information : (H, W) float32
        `entropy` minus the mean entropy of the passes in nats, at least 0.
    """

    mean: Float
    variance: Float
    epistemic: Float
    entropy: Float
    mutual_information: Float


@dataclass(slots=True)
class Moments:
    """Sums (C, H, W) of the softmax and its squares, and (H, W) of its entropy in nats; float64."""

    count: int
    sum: Double
    sum_of_squares: Double
    sum_of_entropies: Double

    def add(self, softmax: Float, nats: Float | None, merging: ClassMerging | None) -> None:
        """Add the softmax of a pass.

        Parameters
        ----------
        softmax : (C, H, W) float32
            Probabilities of unmerged classes.
        nats : (H, W) float32, optional
            Their entropy in nats.
        merging : ClassMerging, optional
            Merging of the classes before the addition.
        """
        if merging is not None:
            softmax = merging.add(softmax)
            nats = None if nats is None else entropy(softmax)
        self.count += 1
        values: Float = argument(softmax, np.float32).reshape(-1)
        total = self.sum.reshape(-1)
        squares = self.sum_of_squares.reshape(-1)
        parallel_for_slices(lambda s: _add_up(values[s], total[s], squares[s]), len(values))
        if nats is not None:
            self.sum_of_entropies += nats

    def mean(self) -> Double:
        """Return the mean (C, H, W)."""
        return self.sum / self.count

    def variance(self) -> Double:
        """Return the variance (C, H, W) of the population (paper III-C.2)."""
        mean = self.mean()
        return np.maximum(self.sum_of_squares / self.count - mean * mean, 0)

    def unbiased_variance(self) -> Float:
        """Return the variance (C, H, W) float32 of the population that the passes sample."""
        return (self.variance() * (self.count / (self.count - 1))).astype(np.float32)

    def spread(self) -> SoftmaxSpread:
        """Return mean, variance and entropies of the passes."""
        mean = self.mean()
        variance = self.variance()
        total = entropy(mean)
        information = np.maximum(total - self.sum_of_entropies / self.count, 0)
        return SoftmaxSpread(
            mean=mean.astype(np.float32),
            variance=variance.astype(np.float32),
            epistemic=variance.mean(axis=0).astype(np.float32),
            entropy=total.astype(np.float32),
            mutual_information=information.astype(np.float32),
        )


@compiled
def _add_up(values: Float, total: Double, squares: Double) -> None:
    for i in range(len(values)):
        value = np.float64(values[i])
        total[i] += value
        squares[i] += value * value


def entropy(probabilities: Values) -> Values:
    """Return the entropy over the first dimension in nats, (C, …) to (…) of the same type."""
    # 0 · log 0 is 0: the logarithm of the smallest number makes it so.
    logarithms = np.log(np.maximum(probabilities, np.finfo(probabilities.dtype).tiny))
    # A softmax that was rounded to above 1 would have a negative entropy.
    return np.maximum(-(probabilities * logarithms).sum(axis=0), 0)
