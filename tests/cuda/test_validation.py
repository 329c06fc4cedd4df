# SPDX-License-Identifier: MIT
# ruff: noqa: F811
"""A GPU that validates a training has the scores and sampled logits of the CPU kernels."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from devices import CUDA, on_both, waits_refused
from scans import write_sequence
from shallow_network import shallow, weights  # noqa: F401
from unlike_sensors import for_unlike_sensor

from salsanext_cli import load_network
from salsanext_cli.runs.loop.network_task import network_pipeline
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.training.data.sources import Source
from salsanext_cli.training.scoring.device_validation import DeviceValidation
from salsanext_cli.training.scoring.validation import validation_job


@on_both("float32")
def test_a_device_validates_as_the_kernels_do(tmp_path, weights, device, precision):
    """But for few points, at borders where a GPU rounds an angle otherwise."""
    for number, count in enumerate((900, 300, 1500)):
        write_sequence(tmp_path / f"sequences/0{number % 2}", [str(number)], count=count)
    network = load_network(weights, "cpu", precision=precision, engine="torch")
    fitted = {"01": replace(network.sensor, fov_up=5.0, ego_box=(1, -9, -2, 9, 3, 1))}
    files = find_scans(tmp_path)
    source = Source(files=files, space=network.card.space, sensor=network.sensor, fitted=fitted)
    job = validation_job(network, source)
    expected = [*network_pipeline(job, network).results(files)]
    there = load_network(weights, device, precision=precision, engine="torch")
    on_device = DeviceValidation(network=there, source=source)
    prepared = [on_device.prepare(file) for file in files]
    computed = on_device.compute(prepared)
    found = [on_device.finish(scan, each) for scan, each in zip(prepared, computed, strict=True)]
    for one, other in zip(found, expected, strict=True):
        assert abs(one.confusion - other.confusion).sum() <= 0.01 * other.confusion.sum()
        is_same = np.isclose(one.logits, other.logits, atol=1e-3).all(axis=0)
        assert is_same.mean() > 0.99
        assert torch.equal(one.truth, other.truth)


@pytest.mark.parametrize("device", [pytest.param("cuda", marks=CUDA)])
@pytest.mark.filterwarnings("ignore:Synchronization debug mode")
def test_a_batch_waits_for_nothing(tmp_path, weights, device):
    """On the CPU `test_the_host_waits_for_no_batch` says the same."""
    files = find_scans(write_sequence(tmp_path / "08", ["a", "b"], count=900))
    network = for_unlike_sensor(load_network(weights, device, precision="float16", engine="torch"))
    source = Source(files=files, space=network.card.space, sensor=network.sensor)
    job = DeviceValidation(network=network, source=source)
    prepared = [job.prepare(file) for file in files]
    first = job.compute(prepared)
    with waits_refused():
        second = job.compute(prepared)
    for scan, one, other in zip(prepared, first, second, strict=True):
        confusion = job.finish(scan, one).confusion
        np.testing.assert_array_equal(job.finish(scan, other).confusion, confusion)
