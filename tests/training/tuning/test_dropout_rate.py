# SPDX-License-Identifier: MIT
"""Search of the dropout rate."""

import math

import numpy as np

from salsanext_cli.training.tuning.dropout_rate import RATES


def test_rates_are_equal_steps_of_the_logarithm():
    assert (len(RATES), RATES[0], RATES[-1]) == (10, 0.02, 0.5)
    np.testing.assert_allclose(np.diff(np.log(RATES)), math.log(25) / 9)
