# SPDX-License-Identifier: MIT
"""Scans in batches give the bytes that they give one by one."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scans import files_below, labels_below, replace_points, write_sequence

from salsanext_cli.formats.kitti import write_bin
from salsanext_cli.parallel.run import RunOptions
from salsanext_cli.records import Scan
from salsanext_cli.stages.predict import predict_scans

EXTRAS = ("pixel_labels", "probabilities")


def bytes_below(folder):
    found = files_below(folder).items()
    return {name: data for name, data in found if name.endswith((".label", ".npy"))}


def share_alike(found, expected):
    """Return the share of points with the same label."""
    one, other = labels_below(found), labels_below(expected)
    assert one.keys() == other.keys()
    pairs = [(np.frombuffer(one[n], "<u4"), np.frombuffer(other[n], "<u4")) for n in one]
    return sum(int((a == b).sum()) for a, b in pairs) / sum(len(a) for a, _ in pairs)


@pytest.fixture
def nine(on_openvino):
    """Return a world with a sequence of nine scans, of no points, of one and of many."""
    world = on_openvino
    folder = world.data / "sequences" / "05"
    write_sequence(folder, [f"{n:06d}" for n in range(8)], labels=False)
    replace_points(folder / "velodyne" / "000007.bin", [])
    write_bin(folder / "velodyne" / "000008.bin", Scan(np.float32([[5, 1, 0]]), np.float32([0.5])))
    return world


def predict(world, out, **options):
    return predict_scans(world.data / "sequences/05", out, **{"settings": world.network, **options})


def test_the_same_bytes_in_batches_of_any_size(nine, tmp_path):
    predict(nine, tmp_path / "1", extras=EXTRAS)
    expected = bytes_below(tmp_path / "1")
    assert len(expected) == 4 * 9
    outcome = predict(nine, tmp_path / "4", extras=EXTRAS, batch=4)
    assert (outcome.done, outcome.failures) == (9, ())
    assert bytes_below(tmp_path / "4") == expected


def test_scans_that_fail_do_not_keep_the_others(nine, tmp_path):
    """Be it that they cannot be read, or that their result cannot be written."""
    (nine.data / "sequences/05/velodyne/000003.bin").write_bytes(b"cut off")
    blocked = tmp_path / "out/sequences/05/predictions/000002.label"
    blocked.mkdir(parents=True)
    outcome = predict(nine, tmp_path / "out", batch=4, options=RunOptions(overwrite=True))
    assert [failure.scan.stem for failure in outcome.failures] == ["000002", "000003"]
    assert outcome.done == 7


def test_batches_shrink_when_memory_is_short(nine, tmp_path, monkeypatch, caplog):
    """By torch, which computes batches; OpenVINO takes one scan after the other."""
    by_torch, softmax = replace(nine.network, engine="torch"), torch.Tensor.softmax
    predict(nine, tmp_path / "expected", settings=by_torch)

    def short_of_memory(logits, dim):
        if len(logits) > 2:
            raise torch.OutOfMemoryError("no room")
        return softmax(logits, dim)

    monkeypatch.setattr(torch.Tensor, "softmax", short_of_memory)
    outcome = predict(nine, tmp_path / "out", batch=4, settings=by_torch)
    assert (outcome.done, outcome.failures) == (9, ())
    assert "not enough memory for 4 scans at once: 2 now" in caplog.text
    assert share_alike(tmp_path / "out", tmp_path / "expected") > 0.999


@pytest.mark.parametrize(
    ("step", "batch"),
    [
        ("engines.network.knn_refine", 1),
        ("engines.network.Engine.tensor", 4),
    ],
)
def test_scans_that_do_not_fit_into_memory_are_named(nine, tmp_path, monkeypatch, step, batch):
    def no_room(*_args, **_options):
        raise torch.OutOfMemoryError("no room")

    monkeypatch.setattr(f"salsanext_cli.{step}", no_room)
    by_torch = replace(nine.network, engine="torch")
    outcome = predict(nine, tmp_path / "out", batch=batch, settings=by_torch)
    assert len(outcome.failures) == 9
    assert "000000.bin · is too large for the memory of cpu" in outcome.failures[0].reason


@pytest.mark.cuda
@pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU")
@pytest.mark.parametrize("precision", ["float32", "float16", "bfloat16"])
def test_a_gpu_gives_the_labels_of_a_cpu(nine, tmp_path, precision):
    predict(nine, tmp_path / "cpu")
    there = replace(nine.network, device="cuda", precision=precision)
    predict(nine, tmp_path / "gpu", settings=there, batch=4)
    assert share_alike(tmp_path / "gpu", tmp_path / "cpu") >= 0.99
