# SPDX-License-Identifier: MIT
"""Labels and confidence from probabilities."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from salsanext_cli.core.engines.backend import PixelPrediction


@given(st.integers(0, 2**32 - 1), st.sampled_from([(1, 1, 1), (2, 3, 5), (20, 4, 33)]))
def test_labels_and_confidence_are_those_of_numpy_also_where_classes_are_equal(seed, shape):
    softmax = (np.random.default_rng(seed).integers(0, 4, shape) / 4).astype("f4")
    found = PixelPrediction.from_softmax(softmax)
    np.testing.assert_array_equal(found.labels, softmax.argmax(axis=0))
    np.testing.assert_array_equal(found.confidence, softmax.max(axis=0))
    assert (found.labels.dtype, found.confidence.dtype) == (np.uint8, np.float32)
    assert found.softmax is None


def test_a_softmax_that_is_kept_is_a_copy_and_nan_is_seen():
    softmax = np.full((3, 2, 4), 0.25, np.float32)
    found = PixelPrediction.from_softmax(softmax, keep=True)
    softmax[:] = 0
    assert (found.softmax == 0.25).all()
    for place in ((0, 1, 2), (2, 1, 2)):
        broken = np.zeros((3, 2, 4), np.float32)
        broken[place] = np.nan
        assert np.isnan(PixelPrediction.from_softmax(broken).confidence).sum() == 1
