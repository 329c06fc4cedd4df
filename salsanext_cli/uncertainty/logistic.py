# SPDX-License-Identifier: MIT
"""Moments of the logistic function of a Gaussian, by quadrature."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

NODES = 12
"""Nodes of the Gauss-Hermite quadrature."""


def logistic_moments(d: Tensor, variance: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return mean, 1 − mean and variance of the logistic function of N(d, variance).

    Everything is a rise or fall from the smaller of logistic(d) and 1 − logistic(d), so that a
    confident class keeps its digits.
    """
    near, deviation = -d.abs(), variance.sqrt()
    small, large = torch.sigmoid(near), torch.sigmoid(-near)
    slope = small * large
    first, second = torch.zeros_like(d), torch.zeros_like(d)
    nodes, weights = np.polynomial.hermite_e.hermegauss(NODES)
    # The nodes lie in pairs around 0: one half gives steps up and down.
    half = slice(NODES // 2, None)
    pairs = zip(nodes[half].tolist(), (weights / weights.sum())[half].tolist(), strict=True)
    for node, weight in pairs:
        step = deviation * node
        part = torch.expm1(-step).neg_()
        fall = slope * part / (1 - small * part)
        near_rise = slope * part / (1 - large * part)
        rise = torch.where(step < 1, near_rise, torch.sigmoid(near + step) - small)
        first.add_(rise - fall, alpha=weight)
        second.add_(rise.square_() + fall.square_(), alpha=weight)
    small, large = (small + first).clamp_(0, 1), (large - first).clamp_(0, 1)
    spread = (second - first.square()).clamp_(min=0)
    return torch.where(d > 0, large, small), torch.where(d > 0, small, large), spread
