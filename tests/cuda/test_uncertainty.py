# SPDX-License-Identifier: MIT
# ruff: noqa: F811
"""A GPU estimates one scan while the results of the last come back, and waits for no host."""

from dataclasses import replace

import numpy as np
import pytest
from devices import CUDA, waits_refused
from scans import SMALL, make_scan
from shallow_network import shallow, weights  # noqa: F401
from unlike_sensors import for_unlike_sensor

from salsanext_cli import load_network
from salsanext_cli.core.on_device.estimator import DeviceEstimator
from salsanext_cli.core.uncertainty.estimate_request import EstimateRequest
from salsanext_cli.core.uncertainty.method import UncertaintyMethod


@pytest.mark.parametrize("device", [pytest.param("cuda", marks=CUDA)])
@pytest.mark.parametrize("precision", ["float32", "float16"])
@pytest.mark.parametrize("aleatoric", ["copies", "paper", "none"])
@pytest.mark.filterwarnings("ignore:Synchronization debug mode")
def test_a_scan_waits_for_nothing(weights, device, precision, aleatoric):
    """On the CPU `core/on_device/test_waits.py` says the same."""
    network = for_unlike_sensor(load_network(weights, device, SMALL, precision, "torch"))
    noisy = replace(network.sensor, range_noise=0.03, intensity_noise=0.1)
    method = UncertaintyMethod(samples=4, aleatoric=aleatoric)
    estimator = DeviceEstimator(
        network=replace(network, sensor=noisy), request=EstimateRequest(method=method, error=True)
    )
    scans = [estimator.prepare(make_scan(2000, seed), seed) for seed in range(2)]
    # Graphs are recorded, and constants copied.
    first = [*estimator.compute(scans[:1]), *estimator.compute(scans[1:])]
    with waits_refused():
        second = [*estimator.compute(scans[:1]), *estimator.compute(scans[1:])]
    for scan, one, other in zip(scans, first, second, strict=True):
        expected = estimator.finish(scan, one)
        found = estimator.finish(scan, other)
        np.testing.assert_array_equal(found.labels, expected.labels)
        for kind, values in expected.uncertainty.items():
            np.testing.assert_allclose(found.uncertainty[kind], values, rtol=1e-4, atol=1e-6)
