# SPDX-License-Identifier: MIT
import math

import numpy as np
import pytest
import torch
from sklearn.metrics import log_loss

from salsanext_cli.training.tuning.dropout_rate import rates_between
from salsanext_cli.training.tuning.error import JudgedPoints, fit_error
from salsanext_cli.training.tuning.temperature import best_temperature, negative_log_likelihood
from salsanext_cli.uncertainty.error_features import FEATURES

CONFIDENCE = FEATURES.index("probability of the label")
HEIGHT = FEATURES.index("height above the sensor")


def test_rates_are_equal_steps_of_the_logarithm_with_exact_ends():
    rates = rates_between(0.02, 0.5, 10)
    assert len(rates) == 10
    assert (rates[0], rates[-1]) == (0.02, 0.5)
    steps = np.diff(np.log(rates))
    np.testing.assert_allclose(steps, math.log(25) / 9)
    assert rates_between(0.1, 0.2, 2) == [0.1, 0.2]


@pytest.mark.parametrize("height", [True, False])
def test_the_height_is_used_only_if_it_may_be(height: bool) -> None:
    """High points are wrong, and so are some of low confidence."""
    random = np.random.default_rng(0)
    features = random.random((4000, len(FEATURES))).astype("f4")
    wrong = (features[:, HEIGHT] > 0.7) | (features[:, CONFIDENCE] < 0.2)
    model = fit_error([JudgedPoints(features, wrong)], height=height)
    sure, unsure, high = (np.full((1, len(FEATURES)), 0.5, "f4") for _ in range(3))
    unsure[0, CONFIDENCE], high[0, HEIGHT] = 0.05, 0.95
    at = [float(model.probability(each)[0]) for each in (sure, unsure, high)]
    assert at[1] > 0.8 > 0.5 > at[0]
    if height:
        assert at[2] > 0.8
    else:
        assert at[2] == at[0]


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


def test_the_loss_against_scikit_learn():
    logits, truth = drawn(1.3)
    shares = torch.softmax(logits.double() / 0.8, dim=1).numpy()
    expected = log_loss(truth.numpy(), shares, labels=range(5))
    assert negative_log_likelihood(logits, truth, 0.8) == pytest.approx(expected, rel=1e-12)


def test_where_there_is_no_best():
    logits, _ = drawn(1.0)
    assert best_temperature(logits, logits.argmax(dim=1)) == 0
    assert best_temperature(logits, logits.argmin(dim=1)) == math.inf
    assert best_temperature(torch.zeros(3, 2), torch.tensor([0, 1, 0])) in (0, math.inf)
