# SPDX-License-Identifier: MIT
"""Fit of the probability that a label is wrong, with and without the height."""

import numpy as np
import pytest

from salsanext_cli.training.tuning.error import fit_error
from salsanext_cli.training.tuning.judged_points import JudgedPoints
from salsanext_cli.uncertainty.error_features import FEATURES

CONFIDENCE = FEATURES.index("probability of the label")
HEIGHT = FEATURES.index("height above the sensor")


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
