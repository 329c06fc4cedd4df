# SPDX-License-Identifier: MIT
# ruff: noqa: F811
"""The uncertainty of a scan by the kernels, and the choice of a device."""

import copy
from dataclasses import replace

import numpy as np
import pytest
from scans import SMALL, make_scan
from shallow_network import shallow, weights  # noqa: F401

from salsanext_cli import knn_refine, load_network, project
from salsanext_cli.core.errors import WeightsError
from salsanext_cli.core.estimators import KernelEstimator, estimator_for
from salsanext_cli.core.geometry.projection import points_from_pixels
from salsanext_cli.core.on_device.estimator import DeviceEstimator
from salsanext_cli.core.uncertainty.estimate_request import EstimateRequest
from salsanext_cli.core.uncertainty.method import UncertaintyMethod
from salsanext_cli.core.uncertainty.monte_carlo import sample

METHOD = UncertaintyMethod(samples=2, aleatoric="none")


@pytest.fixture(scope="module")
def network(weights):
    return load_network(weights, "cpu", SMALL, engine="torch")


@pytest.mark.parametrize("labels", [False, True])
def test_results_are_those_of_the_single_steps(network, labels):
    estimator = KernelEstimator(
        network=network, request=EstimateRequest(method=METHOD, labels=labels)
    )
    prepared = estimator.prepare(make_scan(), 5)
    found = estimator.finish(prepared, *estimator.compute([prepared]))
    image = project(make_scan(), SMALL)
    expected = sample(network, image, samples=2, seed=5)
    assert tuple(found.uncertainty) == METHOD.kinds
    for kind, values in found.uncertainty.items():
        pixel_values = getattr(expected.uncertainty, kind)
        of_points = points_from_pixels(pixel_values, image.pixel_of_point, np.nan)
        np.testing.assert_array_equal(values, of_points)
    assert found.error is None
    if labels:
        pixel_labels = expected.probabilities.argmax(axis=0)
        refined = knn_refine(image, pixel_labels, network.space.class_count)
        np.testing.assert_array_equal(found.labels, refined)
    else:
        assert found.labels is None


def test_probabilities_that_are_not_finite_are_refused(network):
    module = copy.deepcopy(network.module)
    module.logits.bias.data.fill_(np.nan)
    backend = replace(network.backend, load_module=lambda: module)
    broken = replace(network, backend=backend)
    estimator = KernelEstimator(network=broken, request=EstimateRequest(method=METHOD))
    prepared = estimator.prepare(make_scan(), 0, source="a.bin")
    with pytest.raises(WeightsError, match=r"a\.bin"):
        estimator.compute([prepared])


def test_a_network_on_a_gpu_estimates_there(network, monkeypatch):
    """Torch on a CPU leaves it to the kernels."""
    monkeypatch.setattr("salsanext_cli.core.engines.torch_backend.set_up_cuda", lambda: None)
    request = EstimateRequest(method=METHOD)
    assert isinstance(estimator_for(network, request), KernelEstimator)
    on_gpu = replace(network, backend=replace(network.backend, device="cuda"))
    assert isinstance(estimator_for(on_gpu, request), DeviceEstimator)
