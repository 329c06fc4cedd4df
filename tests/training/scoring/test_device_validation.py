# SPDX-License-Identifier: MIT
"""Validation on a device, beside that of the CPU kernels."""

# ruff: noqa: F811
import copy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from host_waits import META, WaitsRefused
from scans import SMALL, write_sequence
from shallow_network import shallow, weights  # noqa: F401
from unlike_sensors import for_unlike_sensor

from salsanext_cli import load_network
from salsanext_cli.core.engines.device_copies import HostCopies
from salsanext_cli.runs.loop.network_task import network_pipeline
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.training.data.sources import Source
from salsanext_cli.training.scoring import device_validation, validated_scan, validation
from salsanext_cli.training.scoring.device_validation import sampled_points


@pytest.mark.parametrize("most", [300, 10**6])
def test_a_device_validates_as_the_kernels_do(tmp_path: Path, weights: Path, monkeypatch, most):
    """Scans of unlike lengths and sensors, with a sample of their points and with all."""
    for module in (device_validation, validated_scan):
        monkeypatch.setattr(module, "MAX_VALIDATED_POINTS", most)
    for number, count in enumerate((900, 300, 1500)):
        write_sequence(tmp_path / f"sequences/0{number % 2}", [str(number)], count=count)
    network = load_network(weights, "cpu", engine="torch")
    fitted = {"01": replace(network.sensor, fov_up=5.0, ego_box=(1, -9, -2, 9, 3, 1))}
    files = find_scans(tmp_path)
    source = Source(files=files, space=network.card.space, sensor=network.sensor, fitted=fitted)
    expected = [
        *network_pipeline(validation.validation_job(network, source), network).results(files)
    ]
    monkeypatch.setattr(validation, "computes_on_gpu", lambda _: True)
    job = validation.validation_job(network, source)
    assert isinstance(job, device_validation.DeviceValidation)
    prepared = [job.prepare(file) for file in files]
    found = [*map(job.finish, prepared, job.compute(prepared))]
    for one, other in zip(found, expected, strict=True):
        assert one.logits.shape[1] == len(one.truth)
        np.testing.assert_array_equal(one.confusion, other.confusion)
        assert one.truth.tolist() == other.truth.tolist()
        torch.testing.assert_close(one.logits, other.logits, rtol=1e-5, atol=1e-5)
        assert len(one.truth) <= 2 * most // len(files) + 1
    assert sum(len(scan.truth) for scan in found) > 100


@pytest.mark.parametrize("scans", [1, 3, 50])
def test_a_sample_is_every_so_many_of_the_usable_points(scans: int, monkeypatch) -> None:
    monkeypatch.setattr(device_validation, "MAX_VALIDATED_POINTS", 100)
    monkeypatch.setattr(validated_scan, "MAX_VALIDATED_POINTS", 100)
    random = np.random.default_rng(scans)
    counts = [0, 400, 7, 90]
    is_usable = random.random(sum(counts)) < 0.6
    sample = sampled_points(torch.from_numpy(is_usable), counts, scans)
    start = 0
    for points, taken, count in zip(sample.point, sample.count, counts, strict=True):
        usable = start + np.flatnonzero(is_usable[start : start + count])
        every = validated_scan.sample_interval(len(usable), scans)
        assert points[:taken].tolist() == usable[::every].tolist()
        start += count
    there = torch.from_numpy(is_usable).to(META)
    with WaitsRefused():
        assert sampled_points(there, counts, scans).point.is_meta
    assert sampled_points(torch.zeros(0, dtype=torch.bool), [0], 1).count.tolist() == [0]


def test_the_host_waits_for_no_batch(tmp_path: Path, weights: Path, monkeypatch) -> None:
    """Device "meta" stands for the GPU."""
    files = find_scans(write_sequence(tmp_path / "08", ["a", "b"], count=400))
    network = for_unlike_sensor(load_network(weights, "cpu", engine="torch"))
    on_meta = copy.deepcopy(network.module).to(META)
    backend = replace(network.backend, load_module=lambda: on_meta, device="meta", records=False)
    network = replace(network, backend=backend)
    source = Source(files=files, space=network.card.space, sensor=network.sensor)
    job = device_validation.DeviceValidation(network=network, source=source)
    prepared = [job.prepare(file) for file in files]
    pinned = [scan.points.points for scan in prepared]
    pinned += [scan.points.intensity for scan in prepared]
    copied: list[torch.Tensor] = []
    monkeypatch.setattr(HostCopies, "of", copied.extend)
    with WaitsRefused(pinned):
        job.compute(prepared)
    assert [tensor.device.type for tensor in copied] == ["meta"] * 5


def test_scores_of_a_device_are_those_of_the_validation(tmp_path, weights, monkeypatch) -> None:
    files = find_scans(write_sequence(tmp_path / "08", ["a", "b"], count=400))
    network = load_network(weights, "cpu", engine="torch")
    assert network.sensor == SMALL
    source = Source(files=files, space=network.card.space, sensor=network.sensor)
    expected, _ = validation.validate(network, source)
    monkeypatch.setattr(validation, "computes_on_gpu", lambda _: True)
    row, _ = validation.validate(network, source)
    assert row == pytest.approx(expected, rel=1e-4, nan_ok=True)
