# SPDX-License-Identifier: MIT
"""Fit of the error model."""

import numpy as np
import pytest

from salsanext_cli.core.network.error_model import ErrorModel
from salsanext_cli.core.uncertainty.error_features import FEATURES
from salsanext_cli.training.tuning.error_training import JudgedPoints, fit_error

CONFIDENCE = FEATURES.index("probability of the label")
HEIGHT = FEATURES.index("height above the sensor")


def points(wrong_if, count: int = 4000, seed: int = 0) -> JudgedPoints:
    """Return random features, and wrong labels by a function of them."""
    features = np.random.default_rng(seed).random((count, len(FEATURES))).astype("f4")
    return JudgedPoints(features=features, wrong=wrong_if(features))


def test_low_confidence_is_wrong_at_any_height() -> None:
    """High points are wrong, and so are some of low confidence."""
    model = fit_error([points(lambda x: (x[:, HEIGHT] > 0.7) | (x[:, CONFIDENCE] < 0.2))])
    sure, unsure, high = (np.full((1, len(FEATURES)), 0.5, "f4") for _ in range(3))
    unsure[0, CONFIDENCE], high[0, HEIGHT] = 0.05, 0.95
    at = [float(model.probability(features)[0]) for features in (sure, unsure, high)]
    assert at[1] > 0.8 > 0.5 > at[0]
    assert at[2] == at[0]


@pytest.fixture(scope="module")
def start() -> ErrorModel:
    """Return a model by which a tenth of the points are wrong."""
    return fit_error([points(lambda x: x[:, CONFIDENCE] < 0.1)])


@pytest.mark.parametrize("sequences", [1, 7, 63])
def test_more_sequences_correct_an_existing_model_more(start: ErrorModel, sequences: int) -> None:
    """All new points are wrong, a tenth of them by the existing model."""
    new = points(lambda x: np.full(len(x), True))
    fitted = fit_error([new], start, sequences).probability(new.features)
    share = sequences / (sequences + 7)
    expected = share + (1 - share) * start.probability(new.features)
    assert fitted.mean() == pytest.approx(expected.mean(), abs=0.02)
    assert np.abs(fitted - expected).mean() < 0.1
