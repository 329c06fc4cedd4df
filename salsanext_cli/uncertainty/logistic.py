# SPDX-License-Identifier: MIT
"""Moments of the logistic function of a Gaussian, by quadrature."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch
from torch import Tensor

from salsanext_cli.uncertainty.derivatives import differentiable

NODES = 12
"""Of the Gauss-Hermite quadrature."""
LEAST = 1e-6
"""Standard deviation at which the derivatives of what is certain are taken: they are 0/0 at 0."""


def logistic_moments(d: Tensor, variance: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return mean, 1 − mean and variance of the logistic function of N(d, variance)."""
    mean, complement, spread = differentiable(_moments, _gradients, d, variance)
    return mean, complement, spread


def _moments(d: Tensor, variance: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return the moments.

    Everything is a rise or fall from the smaller of logistic(d) and 1 − logistic(d), so that a
    confident class keeps its digits.
    """
    near = -d.abs()
    small, large = torch.sigmoid(near), torch.sigmoid(-near)
    first, second = torch.zeros_like(d), torch.zeros_like(d)
    for _, weight, rise, fall in _changes(near, variance.sqrt()):
        first.add_(rise - fall, alpha=weight)
        second.add_(rise.square_() + fall.square_(), alpha=weight)
    small, large = (small + first).clamp_(0, 1), (large - first).clamp_(0, 1)
    spread = (second - first.square()).clamp_(min=0)
    return torch.where(d > 0, large, small), torch.where(d > 0, small, large), spread


def _changes(near: Tensor, deviation: Tensor) -> Iterator[tuple[float, float, Tensor, Tensor]]:
    """Yield nodes, weights, and what logistic(near ≤ 0) gains and loses a step up and down."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(NODES)
    # The nodes lie in pairs around 0: one half gives steps up and down.
    half = slice(NODES // 2, None)
    small, large = torch.sigmoid(near), torch.sigmoid(-near)
    slope = small * large
    pairs = zip(nodes[half].tolist(), (weights / weights.sum())[half].tolist(), strict=True)
    for node, weight in pairs:
        step = deviation * node
        part = torch.expm1(-step).neg_()
        fall = slope * part / (1 - small * part)
        near_rise = slope * part / (1 - large * part)
        rise = torch.where(step < 1, near_rise, torch.sigmoid(near + step) - small)
        yield node, weight, rise, fall


def _gradients(
    d: Tensor, variance: Tensor, of_mean: Tensor, of_complement: Tensor, of_spread: Tensor
) -> tuple[Tensor, Tensor]:
    """Carry gradients of the moments back to d and v.

    They are the derivatives of the quadrature, with s the logistic function at its nodes z::

        ∂mean/∂d = Σ w s′                 ∂mean/∂√v = Σ w z s′
        ∂variance/∂d = 2 Cov[s, s′]       ∂variance/∂√v = 2 Σ w z s′ (s − Σ w s)

    Both s and s′ = s (1 − s) are rises from their values at d, so that nothing cancels where v is
    small.
    """
    near, deviation = -d.abs(), variance.sqrt().clamp(min=LEAST)
    small = torch.sigmoid(near)
    slope = small * torch.sigmoid(-near)
    drift, steeper, along, bend, swing = (torch.zeros_like(d) for _ in range(5))
    for node, weight, rise, fall in _changes(near, deviation):
        for z, change in ((node, rise), (-node, fall.neg_())):
            gain = change * (1 - 2 * small - change)
            drift.add_(change, alpha=weight)
            steeper.add_(gain, alpha=weight)
            along.addcmul_(change, gain, value=weight)
            bend.add_(gain, alpha=weight * z)
            swing.addcmul_(change, slope + gain, value=weight * z)
    sign = torch.where(d > 0, -1, 1)
    of_mean = of_mean - of_complement
    by_d = of_mean * (slope + steeper) + 2 * sign * of_spread * (along - drift * steeper)
    by_deviation = sign * of_mean * bend + 2 * of_spread * (swing - drift * bend)
    return by_d, by_deviation / (2 * deviation)
