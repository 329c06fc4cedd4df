# SPDX-License-Identifier: MIT
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import spearmanr

from salsanext_cli.measures.correlation import spearman

PAIRS = st.lists(st.tuples(st.integers(0, 6), st.floats(-1e9, 1e9)), min_size=2, max_size=30)


@settings(max_examples=40, deadline=None)
@given(PAIRS.filter(lambda pairs: all(len(set(column)) > 1 for column in zip(*pairs, strict=True))))
def test_correlation_is_scipys(pairs):
    one, other = (np.array(column) for column in zip(*pairs, strict=True))
    expected = spearmanr(one, other).statistic
    assert spearman(one, other) == pytest.approx(expected, abs=1e-13)


@pytest.mark.parametrize("values", [[], [1.0], [2.0, 2.0, 2.0]], ids=str)
def test_what_does_not_vary_has_no_correlation(values):
    assert math.isnan(spearman(np.array(values), np.arange(len(values))))
