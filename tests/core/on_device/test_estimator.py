# SPDX-License-Identifier: MIT
# ruff: noqa: F811
"""The uncertainty of scans on a device is that of the kernels, with the same masks and noise."""

import copy
from dataclasses import replace

import numpy as np
import pytest
from devices import on_each_device
from error_models import layers
from scans import SMALL, make_scan
from shallow_network import shallow, weights  # noqa: F401

from salsanext_cli import Network, Scan, load_network
from salsanext_cli.core.classes.merging import ClassMerging
from salsanext_cli.core.errors import WeightsError
from salsanext_cli.core.estimators import Estimator, KernelEstimator
from salsanext_cli.core.labelling import EstimatedScan
from salsanext_cli.core.network.error_model import ErrorModel
from salsanext_cli.core.on_device.estimator import DeviceEstimator
from salsanext_cli.core.uncertainty.error_features import FEATURES
from salsanext_cli.core.uncertainty.estimate_request import EstimateRequest
from salsanext_cli.core.uncertainty.method import UncertaintyMethod
from salsanext_cli.io.label_spaces import label_space

SENSOR = replace(SMALL, min_range=4.5, range_noise=0.03, intensity_noise=0.1)
SCANS = [make_scan(3000), make_scan(1500, 2)]


def request_of(aleatoric: str, **results: bool) -> EstimateRequest:
    return EstimateRequest(method=UncertaintyMethod(samples=2, aleatoric=aleatoric), **results)


@pytest.fixture
def network(weights, device: str) -> Network:
    """Return a network with an error model for a noisy sensor, on the device."""
    return with_error_model(load_network(weights, device, SMALL, "float32", "torch"))


def with_error_model(network: Network) -> Network:
    model = ErrorModel(features=FEATURES, layers=layers(9, 6, 1))
    card = replace(network.card, error=model)
    return replace(network, backend=replace(network.backend, card=card), sensor=SENSOR)


def estimated_by(estimator: Estimator, scans: list[Scan]) -> list[EstimatedScan]:
    prepared = [estimator.prepare(scan, number) for number, scan in enumerate(scans)]
    computed = estimator.compute(prepared)
    return [estimator.finish(*pair) for pair in zip(prepared, computed, strict=True)]


def assert_same(found: list[EstimatedScan], expected: list[EstimatedScan]) -> None:
    for scan, other in zip(found, expected, strict=True):
        assert scan.checked.check == other.checked.check
        assert list(scan.uncertainty) == list(other.uncertainty)
        for kind, values in other.uncertainty.items():
            assert scan.uncertainty[kind].dtype == np.float32
            assert np.nanmax(values) > 0
            np.testing.assert_allclose(scan.uncertainty[kind], values, rtol=1e-3, atol=1e-6)
        assert (scan.labels is None) == (other.labels is None)
        if other.labels is not None:
            assert (scan.labels != other.labels).mean() <= 1e-3
        assert (scan.error is None) == (other.error is None)
        if other.error is not None:
            np.testing.assert_allclose(scan.error, other.error, atol=1e-4)


@on_each_device
@pytest.mark.parametrize(
    "request_",
    [
        request_of("copies", error=True),
        pytest.param(request_of("paper", labels=False), marks=pytest.mark.slow),
    ],
)
def test_results_are_those_of_the_kernels(network, weights, request_):
    on_cpu = with_error_model(load_network(weights, "cpu", SMALL, "float32", "torch"))
    found = estimated_by(DeviceEstimator(network=network, request=request_), SCANS)
    assert found[0].checked.check.ego_points > 0
    assert_same(found, estimated_by(KernelEstimator(network=on_cpu, request=request_), SCANS))


@pytest.mark.slow
@on_each_device
def test_merged_classes(network, weights):
    merging = ClassMerging.between(network.space, label_space("coarse"))
    request = request_of("copies")
    on_cpu = with_error_model(load_network(weights, "cpu", SMALL, "float32", "torch"))
    kernels = KernelEstimator(network=replace(on_cpu, merging=merging), request=request)
    on_device = DeviceEstimator(network=replace(network, merging=merging), request=request)
    assert_same(estimated_by(on_device, SCANS), estimated_by(kernels, SCANS))


@on_each_device
def test_errors_are_final_after_any_number_of_rounds(network):
    estimator = DeviceEstimator(network=network, request=request_of("none", error=True))
    prepared = estimator.prepare(SCANS[0], 0)
    (computed,) = estimator.compute([prepared], rounds=1)
    assert not computed.results()["is_final"]
    assert_same([estimator.finish(prepared, computed)], estimated_by(estimator, SCANS[:1]))


@on_each_device
def test_results_that_are_not_finite_name_the_source(network):
    module = copy.deepcopy(network.module)
    module.logits.bias.data.fill_(np.nan)
    backend = replace(network.backend, load_module=lambda: module)
    broken = replace(network, backend=backend)
    estimator = DeviceEstimator(network=broken, request=request_of("none"))
    prepared = estimator.prepare(SCANS[0], 0, source="a.bin")
    (computed,) = estimator.compute([prepared])
    with pytest.raises(WeightsError, match=r"a\.bin"):
        estimator.finish(prepared, computed)
