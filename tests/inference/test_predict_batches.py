# SPDX-License-Identifier: MIT
"""Scans in batches give the bytes that they give one by one."""

import threading
from dataclasses import replace

import numpy as np
import pytest
import torch
from salsanext_cli.inference.batches import BatchLabeller
from salsanext_cli.inference.predict_batches import usual_size
from scans import make_scan, write_sequence

from salsanext_cli.errors import UsageError
from salsanext_cli.geometry.knn import KnnParameters
from salsanext_cli.parallel.run import RunOptions
from salsanext_cli.records import Scan
from salsanext_cli.storage.point_files import write_bin

EXTRAS = ("pixel_labels", "probabilities")
NEEDS_A_GPU = pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU")


def bytes_below(folder):
    files = (path for path in folder.rglob("*") if path.suffix in (".label", ".npy"))
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


@pytest.fixture
def nine(world):
    """Return a world with a sequence of nine scans, of no points, of one and of many."""
    stems = [f"{n:06d}" for n in range(7)]
    folder = world.data / "sequences" / "05"
    write_sequence(folder, stems, labels=False)
    nothing = Scan(np.empty((0, 3), np.float32), np.empty(0, np.float32))
    write_bin(folder / "velodyne" / "000007.bin", nothing)
    write_bin(folder / "velodyne" / "000008.bin", Scan(np.float32([[5, 1, 0]]), np.float32([0.5])))
    return world


@pytest.mark.parametrize("size", [2, 4, 64])
def test_the_same_bytes_in_batches_of_any_size(nine, tmp_path, size):
    scans = nine.data / "sequences" / "05"
    predict(scans, tmp_path / "one", network=nine.network, extras=EXTRAS)
    outcome = predict(scans, tmp_path / "many", network=nine.network, extras=EXTRAS, batch=size)
    assert (outcome.done, outcome.failures) == (9, ())
    expected = bytes_below(tmp_path / "one")
    assert len(expected) == 3 * 9
    assert bytes_below(tmp_path / "many") == expected


def test_scans_that_fail_do_not_keep_the_others(nine, tmp_path):
    scans = nine.data / "sequences" / "05"
    (scans / "velodyne" / "000003.bin").write_bytes(b"cut off")
    outcome = predict(scans, tmp_path / "out", network=nine.network, batch=4)
    assert outcome.done == 8
    assert [failure.scan.stem for failure in outcome.failures] == ["000003"]
    assert len(bytes_below(tmp_path / "out")) == 8


def test_results_that_cannot_be_written_are_failures(nine, tmp_path):
    scans, out = nine.data / "sequences" / "05", tmp_path / "out"
    blocked = out / "sequences" / "05" / "predictions" / "000002.label"
    blocked.mkdir(parents=True)
    options = RunOptions(overwrite=True)
    outcome = predict(scans, out, network=nine.network, batch=4, options=options)
    assert [failure.scan.stem for failure in outcome.failures] == ["000002"]
    assert outcome.done == 8


def test_no_more_is_read_than_is_soon_needed(nine, tmp_path, monkeypatch):
    from salsanext_cli.inference import predict_batches as module

    read, most, lock = 0, 0, threading.Lock()
    original = module._read

    def reading(file, network):
        nonlocal read, most
        with lock:
            read += 1
            most = max(most, read)
        return original(file, network)

    label = BatchLabeller.label

    def labelling(self, scans):
        nonlocal read
        with lock:
            read -= len(scans)
        return label(self, scans)

    monkeypatch.setattr(module, "_read", reading)
    monkeypatch.setattr(BatchLabeller, "label", labelling)
    predict(nine.data / "sequences" / "05", tmp_path / "out", network=nine.network, batch=2)
    assert 2 <= most <= 2 * module.AHEAD


def test_batches_shrink_when_memory_is_short(nine, monkeypatch, caplog):
    network = nine.network.load()
    scan = make_scan()
    points = torch.from_numpy(scan.points), torch.from_numpy(scan.intensity)
    expected = BatchLabeller(network, KnnParameters(), 1).label([points] * 5)
    labeller = BatchLabeller(network, KnnParameters(), 4)
    engine, most = labeller.logits.engine, 2

    def short_of_memory(images):
        if len(images) > most:
            raise torch.OutOfMemoryError("no room")
        return engine(images)

    monkeypatch.setattr(labeller.logits, "engine", short_of_memory)
    found = labeller.label([points] * 5)
    assert labeller.size == 2
    assert "memory for 4 scans at once is not there, going on with 2" in caplog.text
    assert len(found) == 5
    for one, other in zip(found, expected, strict=True):
        assert torch.equal(one.labels, other.labels)
    most = 0
    with pytest.raises(torch.OutOfMemoryError):
        labeller.label([points])


def test_a_scan_that_does_not_fit_fails_alone(nine, tmp_path, monkeypatch):
    label = BatchLabeller._label

    def short_of_memory(self, scans):
        if any(len(points) > 1000 for points, _ in scans):
            raise torch.OutOfMemoryError("no room")
        return label(self, scans)

    write_sequence(nine.data / "sequences" / "05", ["000009"], count=900, labels=False)
    monkeypatch.setattr(BatchLabeller, "_label", short_of_memory)
    outcome = predict(
        nine.data / "sequences" / "05", tmp_path / "out", network=nine.network, batch=4
    )
    assert outcome.done == 3
    assert len(outcome.failures) == 7
    assert "1500 points are too many for the memory of cpu" in outcome.failures[0].reason


def test_sizes_of_batches(nine, tmp_path):
    assert usual_size(nine.network.load()) == 1
    on_gpu = replace(nine.network.load(), precision="bfloat16", device=torch.device("cuda"))
    assert usual_size(on_gpu) == 16
    with pytest.raises(UsageError, match="--batch"):
        predict(nine.data, tmp_path / "out", network=nine.network, batch=0)


@pytest.mark.cuda
@NEEDS_A_GPU
@pytest.mark.parametrize("precision", ["float32", "float16", "bfloat16"])
def test_a_gpu_gives_the_labels_of_a_cpu(nine, tmp_path, precision):
    scans = nine.data / "sequences" / "05"
    predict(scans, tmp_path / "cpu", network=nine.network)
    there = replace(nine.network, device="cuda", precision=precision)
    predict(scans, tmp_path / "gpu", network=there, batch=4)
    expected, found = bytes_below(tmp_path / "cpu"), bytes_below(tmp_path / "gpu")
    assert found.keys() == expected.keys()
    pairs = [(np.frombuffer(found[n], "<u4"), np.frombuffer(expected[n], "<u4")) for n in found]
    same = sum(int((one == other).sum()) for one, other in pairs)
    assert same >= 0.99 * sum(len(one) for one, _ in pairs)


@pytest.mark.cuda
@NEEDS_A_GPU
def test_a_recorded_network_gives_what_it_gives_unrecorded(nine):
    network = replace(nine.network, device="cuda", precision="float16").load()
    labeller = BatchLabeller(network, KnnParameters(), 4)
    images = torch.randn(4, 5, 16, 128, device="cuda").contiguous(memory_format=torch.channels_last)
    with torch.inference_mode():
        for batch in (images, images.flip(0)):
            torch.testing.assert_close(labeller.logits(batch), network.engine(batch))
