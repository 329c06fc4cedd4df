# SPDX-License-Identifier: MIT
import math

import numpy as np
import pytest

from salsanext_cli.training.tuning.dropout_rate import (
    SMALLEST_VARIANCE,
    objective,
    rates_between,
)


def slow_objective(probabilities, variance, truth):
    total = 0.0
    for point, own in enumerate(truth):
        for place in range(probabilities.shape[1]):
            s = max(float(variance[point, place]), SMALLEST_VARIANCE)
            y = 1.0 if place == own else 0.0
            total += 0.5 * math.log(s) + (y - float(probabilities[point, place])) ** 2 / (2 * s)
    return total


def test_against_a_slow_loop():
    random = np.random.default_rng(0)
    probabilities = random.dirichlet(np.ones(6), 200).astype(np.float32)
    variance = random.choice([0, 1e-9, 1e-4, 0.1], (200, 6)).astype(np.float32)
    truth = random.integers(0, 6, 200).astype(np.uint8)
    expected = slow_objective(probabilities, variance, truth)
    assert objective(probabilities, variance, truth) == pytest.approx(expected, rel=1e-10)


def test_rates_are_equal_steps_of_the_logarithm_with_exact_ends():
    rates = rates_between(0.02, 0.5, 10)
    assert len(rates) == 10
    assert (rates[0], rates[-1]) == (0.02, 0.5)
    steps = np.diff(np.log(rates))
    np.testing.assert_allclose(steps, math.log(25) / 9)
    assert rates_between(0.1, 0.2, 2) == [0.1, 0.2]
