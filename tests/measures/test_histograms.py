# SPDX-License-Identifier: MIT

import numpy as np
from scipy.stats import entropy

from salsanext_cli.measures.histograms import lack_of_confidence, softmax_entropy


def test_entropy_is_that_of_scipy_and_confidence_the_largest():
    powers = np.exp(np.random.default_rng(0).normal(0, 4, (300, 20)))
    softmax = powers / powers.sum(axis=1, keepdims=True)
    found = softmax_entropy(softmax)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, entropy(softmax, axis=1), atol=1e-5)
    np.testing.assert_allclose(lack_of_confidence(softmax), 1 - softmax.max(axis=1), atol=1e-6)


def test_confident_points_differ_although_float16_rounds_them_to_1():
    rows = np.array([[1 - 1e-4, 1e-4], [1 - 1e-5, 1e-5]], np.float16)
    assert (rows[:, 0] == 1).all()
    np.testing.assert_allclose(lack_of_confidence(rows), [1e-4, 1e-5], rtol=5e-3)
