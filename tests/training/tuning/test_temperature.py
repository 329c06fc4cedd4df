# SPDX-License-Identifier: MIT
"""Fit of the temperature."""

import math

import numpy as np
import pytest
import torch

from salsanext_cli.training.tuning.temperature import best_temperature, negative_log_likelihood


def drawn(temperature: float, count: int = 3000, classes: int = 5, seed: int = 0):
    """Logits, and classes drawn from their softmax at a temperature."""
    random = torch.Generator().manual_seed(seed)
    logits = 3 * torch.randn(count, classes, generator=random)
    shares = torch.softmax(logits / temperature, dim=1)
    return logits, torch.multinomial(shares, 1, generator=random)[:, 0]


@pytest.mark.parametrize("temperature", [0.3, 1.0, 2.5, 20.0])
def test_the_best_is_the_lowest_of_a_dense_grid(temperature):
    logits, truth = drawn(temperature)
    best = best_temperature(logits, truth)
    grid = np.geomspace(best / 2, best * 2, 201)
    losses = [negative_log_likelihood(logits, truth, value) for value in grid]
    assert grid[np.argmin(losses)] == pytest.approx(best, rel=0.007)
    assert negative_log_likelihood(logits, truth, best) <= min(losses)


def test_no_best_temperature_is_zero_or_infinite():
    logits, _ = drawn(1.0)
    assert best_temperature(logits, logits.argmax(dim=1)) == 0
    assert best_temperature(logits, logits.argmin(dim=1)) == math.inf
    assert best_temperature(torch.zeros(3, 2), torch.tensor([0, 1, 0])) in (0, math.inf)
