# SPDX-License-Identifier: MIT
# ruff: noqa: F811
"""The host hands a batch to the device without waiting for it."""

import copy
from dataclasses import replace

import pytest
import torch
from host_waits import WaitsRefused
from scans import SMALL, make_scan
from shallow_network import shallow, weights  # noqa: F401
from unlike_sensors import for_unlike_sensor

from salsanext_cli import load_network
from salsanext_cli.core.engines.device_copies import HostCopies
from salsanext_cli.core.labelling import LabelRequest
from salsanext_cli.core.on_device.estimator import DeviceEstimator
from salsanext_cli.core.on_device.labeller import DeviceLabeller
from salsanext_cli.core.uncertainty.estimate_request import EstimateRequest
from salsanext_cli.core.uncertainty.method import UncertaintyMethod

SCANS = [make_scan(2000), make_scan(1500, 2)]
POINTS = len(SCANS[0]) + len(SCANS[1])


@pytest.fixture
def network(weights):
    """Return a network on device "meta", which stands for the GPU."""
    network = for_unlike_sensor(load_network(weights, "cpu", SMALL, "float32", "torch"))
    on_meta = copy.deepcopy(network.module).to("meta")
    backend = replace(network.backend, load_module=lambda: on_meta, device="meta", records=False)
    return replace(network, backend=backend)


def copied_without_waiting(job, prepared, monkeypatch):
    """Return the tensors whose copies to the host begin when a batch is computed."""
    copied = []
    monkeypatch.setattr(HostCopies, "of", copied.extend)
    pinned = [scan.points.points for scan in prepared]
    pinned += [scan.points.intensity for scan in prepared]
    pinned += [scan.draws for scan in prepared if getattr(scan, "draws", None) is not None]
    with WaitsRefused(pinned):
        job.compute(prepared)
    assert {tensor.device.type for tensor in copied} == {"meta"}
    return copied


def test_the_host_waits_for_no_label(network, monkeypatch):
    request = LabelRequest(softmax=True, error=True)
    labeller = DeviceLabeller(network=network, request=request)
    prepared = [labeller.prepare(scan) for scan in SCANS]
    copied = copied_without_waiting(labeller, prepared, monkeypatch)
    assert [len(tensor) for tensor in copied].count(POINTS) == 4


@pytest.mark.slow
@pytest.mark.parametrize("aleatoric", ["copies", "paper"])
def test_the_host_waits_for_no_uncertainty(network, aleatoric, monkeypatch):
    noisy = replace(network.sensor, range_noise=0.03, intensity_noise=0.1)
    method = UncertaintyMethod(samples=2, aleatoric=aleatoric)
    request = EstimateRequest(method=method, error=True)
    estimator = DeviceEstimator(network=replace(network, sensor=noisy), request=request)
    prepared = [estimator.prepare(scan, seed) for seed, scan in enumerate(SCANS)]
    with monkeypatch.context() as first_scan:
        first_scan.setattr(torch.Tensor, "pin_memory", lambda tensor: tensor)
        assert network.backend._rates
    copied = copied_without_waiting(estimator, prepared, monkeypatch)
    assert [len(tensor) for tensor in copied].count(POINTS) == len(method.kinds) + 2
