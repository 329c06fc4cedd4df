# SPDX-License-Identifier: MIT
"""The most probable classes of a point come back from two bytes each."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from salsanext_cli.core.fusion.top_classes import LEVELS, STORED, softmax_of, top_classes


def softmax(classes: int, seed: int, count: int = 200) -> np.ndarray:
    powers = np.exp(np.random.default_rng(seed).normal(scale=2, size=(count, classes)))
    return (powers / powers.sum(axis=1, keepdims=True)).astype(np.float32)


@given(st.integers(1, 30), st.integers(0, 2**32 - 1))
def test_the_largest_probabilities_come_back_within_half_a_step(classes, seed):
    values = softmax(classes, seed)
    stored = softmax_of(top_classes(values), classes)
    for before, after in zip(values, stored, strict=True):
        largest = np.sort(before)[::-1][:STORED]
        assert np.count_nonzero(after) <= STORED
        np.testing.assert_allclose(
            np.sort(after)[::-1][: len(largest)], largest, atol=0.51 / LEVELS
        )
        kept = np.flatnonzero(after)
        np.testing.assert_allclose(after[kept], before[kept], atol=0.51 / LEVELS)


@pytest.mark.parametrize("classes", [2, 20])
def test_probabilities_are_in_descending_order(classes):
    probabilities = top_classes(softmax(classes, 3)) & 0xFF
    assert (np.diff(probabilities.astype(int), axis=1) <= 0).all()
