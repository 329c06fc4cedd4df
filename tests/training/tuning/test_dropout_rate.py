# SPDX-License-Identifier: MIT
import math

import numpy as np

from salsanext_cli.training.tuning.dropout_rate import (
    rates_between,
)


def test_rates_are_equal_steps_of_the_logarithm_with_exact_ends():
    rates = rates_between(0.02, 0.5, 10)
    assert len(rates) == 10
    assert (rates[0], rates[-1]) == (0.02, 0.5)
    steps = np.diff(np.log(rates))
    np.testing.assert_allclose(steps, math.log(25) / 9)
    assert rates_between(0.1, 0.2, 2) == [0.1, 0.2]
