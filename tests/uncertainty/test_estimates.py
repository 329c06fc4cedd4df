# SPDX-License-Identifier: MIT
"""Properties that all estimates of uncertainty share."""

from functools import partial

import numpy as np
import pytest
from shallow import slow_on_openvino

from salsanext_cli import load_network, sample
from salsanext_cli.parallel.options import threads_of_workers
from salsanext_cli.uncertainty.aleatoric import aleatoric, noise_variance
from salsanext_cli.uncertainty.dropout_propagation import propagate_dropout


@slow_on_openvino
@pytest.mark.parametrize("estimate", [partial(sample, samples=4, seed=5), propagate_dropout])
def test_shapes_types_and_bounds(network, image, estimate):
    found = estimate(network, image)
    assert found.probabilities.shape == found.variance.shape == (20, 16, 128)
    np.testing.assert_allclose(found.probabilities.sum(axis=0), 1, atol=1e-5)
    np.testing.assert_allclose(found.variance.mean(axis=0), found.uncertainty.epistemic, rtol=1e-5)
    assert found.uncertainty.total is None
    for kind, most in (("epistemic", 0.25), ("entropy", np.log(20)), ("mutual_information", 3)):
        values = getattr(found.uncertainty, kind)
        assert values.shape == (16, 128)
        assert values.dtype == np.float32
        assert np.isfinite(values).all()
        assert 0 <= values.min() <= values.max() <= most + 1e-6
    assert (found.uncertainty.mutual_information <= found.uncertainty.entropy).all()


@pytest.mark.parametrize(
    "variance",
    [
        pytest.param(aleatoric, marks=pytest.mark.slow),
        lambda *given: noise_variance(*given, 5),
        pytest.param(lambda *given: propagate_dropout(*given).variance, marks=pytest.mark.slow),
        lambda *given: sample(*given, samples=4, seed=5).variance,
    ],
    ids=["aleatoric", "copies", "analytic", "sampling"],
)
def test_no_bit_depends_on_the_number_of_threads(weights, image, variance):
    found = []
    for threads in (1, 2, 3):
        with threads_of_workers(threads):
            found.append(variance(load_network(weights, "cpu", engine="openvino"), image))
    np.testing.assert_array_equal(found[1], found[0])
    np.testing.assert_array_equal(found[2], found[0])
