# SPDX-License-Identifier: MIT
"""Fits to held-out scans: epochs, dropout, temperature, errors."""

import math
from itertools import chain
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from salsanext_cli.core.uncertainty.error_features import FEATURES
from salsanext_cli.runs.results.paths import ScanFile
from salsanext_cli.training.cross_validation import expectation, folds
from salsanext_cli.training.tuning.dropout_rate import RATES
from salsanext_cli.training.tuning.error import JudgedPoints, fit_error
from salsanext_cli.training.tuning.temperature import best_temperature, negative_log_likelihood

CONFIDENCE = FEATURES.index("probability of the label")
HEIGHT = FEATURES.index("height above the sensor")


def test_rates_are_equal_steps_of_the_logarithm():
    assert (len(RATES), RATES[0], RATES[-1]) == (10, 0.02, 0.5)
    np.testing.assert_allclose(np.diff(np.log(RATES)), math.log(25) / 9)


def points(wrong_if, count: int = 4000, seed: int = 0) -> JudgedPoints:
    """Return random features, and wrong labels by a function of them."""
    features = np.random.default_rng(seed).random((count, len(FEATURES))).astype("f4")
    return JudgedPoints(features, wrong_if(features))


def test_low_confidence_is_wrong_at_any_height() -> None:
    """High points are wrong, and so are some of low confidence."""
    model = fit_error([points(lambda x: (x[:, HEIGHT] > 0.7) | (x[:, CONFIDENCE] < 0.2))])
    sure, unsure, high = (np.full((1, len(FEATURES)), 0.5, "f4") for _ in range(3))
    unsure[0, CONFIDENCE], high[0, HEIGHT] = 0.05, 0.95
    at = [float(model.probability(features)[0]) for features in (sure, unsure, high)]
    assert at[1] > 0.8 > 0.5 > at[0]
    assert at[2] == at[0]


@pytest.mark.parametrize("sequences", [1, 7, 63])
def test_more_sequences_correct_an_existing_model_more(sequences: int) -> None:
    """All new points are wrong, a tenth of them by the existing model."""
    start = fit_error([points(lambda x: x[:, CONFIDENCE] < 0.1)])
    new = points(lambda x: np.full(len(x), True))
    fitted = fit_error([new], start, sequences).probability(new.features)
    share = sequences / (sequences + 7)
    expected = share + (1 - share) * start.probability(new.features)
    assert fitted.mean() == pytest.approx(expected.mean(), abs=0.02)
    assert np.abs(fitted - expected).mean() < 0.1


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


def scans(*lengths: int) -> list[ScanFile]:
    """Return scans of sequences of some lengths."""
    return [
        ScanFile(f"{name:02}", str(i), Path(f"{name}/velodyne/{i}.bin"))
        for name, length in enumerate(lengths)
        for i in range(length)
    ]


@given(st.lists(st.integers(1, 6), min_size=1, max_size=8), st.integers(2, 6))
def test_every_scan_is_held_out_once_and_no_fold_is_empty(lengths: list[int], count: int) -> None:
    files = scans(*lengths)
    parts = folds(files, count)
    assert sorted(chain(*parts), key=files.index) == files
    assert all(parts)
    assert len(parts) == min(count, len(lengths) if len(lengths) > 1 else len(files))
    if len(lengths) > 1:
        sequences = [{file.sequence for file in part} for part in parts]
        assert sum(map(len, sequences)) == len(lengths), "a sequence in two folds"


def test_folds_of_one_sequence_are_neighbours_and_of_several_whole_sequences() -> None:
    files = scans(7)
    assert folds(files, 3) == [files[:3], files[3:5], files[5:]]
    files = scans(5, 2)
    assert folds(files, 3) == [files[:5], files[5:]]


def row(epoch, miou, accuracy=0.5, temperature=1.0):
    return {"epoch": epoch, "miou": miou, "accuracy": accuracy, "temperature": temperature}


def test_the_epochs_of_the_highest_mean_over_scored_folds_are_chosen():
    logs = [
        [row(1, 0.2), row(2, 0.5, 0.8, 0.5), row(3, 0.4)],
        [row(1, 0.3), row(2, 0.3, 0.6, 2.0), row(3, 0.4)],
    ]
    expected = expectation(logs)
    # 0.4 twice: the fewer epochs win.
    assert (expected.epochs, expected.folds) == (2, 2)
    # The first fold is scored after 3 epochs, the best number of the second; the second after 2.
    assert (expected.miou, expected.accuracy) == pytest.approx((0.35, 0.55))
    spreads = (expected.miou_spread, expected.accuracy_spread)
    assert spreads == pytest.approx((math.sqrt(0.005),) * 2)
    assert expected.temperature == pytest.approx(1.0)
    nothing = [row(1, math.nan), row(2, math.nan)]
    one = expectation([nothing, [row(1, 0.2), row(2, 0.3)]])
    assert (one.epochs, one.folds, one.miou, one.miou_spread) == (2, 1, 0.3, None)
    assert expectation([nothing]) is None
