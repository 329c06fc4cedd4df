# SPDX-License-Identifier: MIT
"""Scores of a training."""

# ruff: noqa: F811
import copy
import logging
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scans import SMALL, write_bin, write_sequence
from shallow_network import shallow, weights  # noqa: F401

from salsanext_cli import Scan, knn_refine, load_network, project, read_labels, read_scan
from salsanext_cli.core.measures.scores import scores
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.texts import HINT
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.training.data.sources import Source
from salsanext_cli.training.distributed import ProcessGroup
from salsanext_cli.training.scoring import validation
from salsanext_cli.training.scoring.validation import validate


def test_scores_count_points_after_knn(tmp_path: Path, weights: Path) -> None:
    """Every point of every scan is counted, not every pixel."""
    files = find_scans(write_sequence(tmp_path / "08", ["a", "b", "c"]))
    network = load_network(weights, "cpu")
    assert network.sensor == SMALL
    space = network.card.space
    expected = np.zeros((20, 20), int)
    for file in files:
        image = project(read_scan(file.path), SMALL)
        predicted = knn_refine(image, network.probabilities(image).argmax(0))
        truth = space.to_train(read_labels(file.label_path))
        np.add.at(expected, (truth, predicted), 1)
    assert expected.sum() == 4500
    wanted = scores(expected, space)
    row, _ = validate(network, Source(files=files, space=space, sensor=network.sensor))
    assert (row["accuracy"], row["miou"]) == (wanted.accuracy, wanted.iou_mean_present)
    found = [row[f"iou_{s.name}"] for s in wanted.classes]
    np.testing.assert_equal(found, [s.iou for s in wanted.classes])


def test_validation_sees_each_sequence_by_its_own_sensor(tmp_path: Path, weights: Path) -> None:
    """Scans upside down, with the sensor that is so, have the labels of upright ones."""
    network = load_network(weights, "cpu")
    rows = []
    for name, sign, up in (("upright", 1, 1), ("hanging", -1, -1)):
        folder = write_sequence(tmp_path / name / "00", ["0", "1"], count=800)
        files = find_scans(folder)
        for file in files:
            scan = read_scan(file.path)
            write_bin(file.path, Scan(scan.points * np.float32([1, sign, sign]), scan.intensity))
        fitted = {"00": replace(network.sensor, up=(0.0, 0.0, float(up)))}
        source = Source(files=files, space=network.card.space, sensor=network.sensor, fitted=fitted)
        row, _ = validate(network, source)
        del row["temperature"]
        rows.append(row)
    np.testing.assert_equal(*rows)
    assert 0 < rows[0]["accuracy"] < 1


def overflow_in_float16(module):
    """Let features before the logits be infinite in float16; logits in float32 do not change."""
    *_, last = (layer for layer in module.modules() if isinstance(layer, torch.nn.BatchNorm2d))
    for values, factor in (
        (last.weight, 2**20),
        (last.bias, 2**20),
        (module.logits.weight, 2**-20),
    ):
        values.data.mul_(factor)


class Threads(ProcessGroup):
    """Workers in threads, whose store exchanges their tensors."""

    def sum(self, tensor):
        return torch.stack(self.gather(tensor)).sum(dim=0)

    def gather(self, tensor, lengths=None):
        tensors, barrier = self.store
        barrier.wait()
        tensors[self.rank] = tensor
        barrier.wait()
        return [*tensors]


@pytest.mark.parametrize("is_gpu", [False, True])
def test_logits_that_overflow_are_validated_in_float32(
    tmp_path, weights, is_gpu, monkeypatch, caplog
):
    monkeypatch.setattr(validation, "computes_on_gpu", lambda _: is_gpu)
    files = find_scans(write_sequence(tmp_path / "08", ["a", "b"], count=400))
    exact = load_network(weights, "cpu", precision="float32", engine="torch")
    source = Source(files=files, space=exact.card.space, sensor=exact.sensor)
    module = exact.backend.module
    expected, expected_card = validate(exact, source)
    half = replace(exact.backend, precision="float16", load_module=lambda: module)
    validate(replace(exact, backend=half), source)
    assert not caplog.messages
    overflow_in_float16(module)
    row, card = validate(replace(exact, backend=replace(half)), source)
    assert [record.levelno for record in caplog.records] == [logging.WARNING]
    assert HINT in caplog.messages[0]
    np.testing.assert_equal(row, expected)
    assert card.temperature == expected_card.temperature
    assert 0 < row["accuracy"] < 1


def test_logits_that_are_not_finite_in_float32_either_have_no_hint(tmp_path, weights, caplog):
    """The hint is `predict` in float32, which refuses them too."""
    files = find_scans(write_sequence(tmp_path / "08", ["a"], count=400))
    exact = load_network(weights, "cpu", precision="float32", engine="torch")
    module = exact.backend.module
    module.logits.weight.data.fill_(torch.nan)
    half = replace(exact.backend, precision="float16", load_module=lambda: module)
    source = Source(files=files, space=exact.card.space, sensor=exact.sensor)
    validate(replace(exact, backend=half), source)
    assert [record.levelno for record in caplog.records] == [logging.WARNING]
    assert HINT not in caplog.messages[0]


def test_workers_with_different_number_types_validate_in_float32(tmp_path, weights, caplog):
    """An overflow in one of them would let it wait for the others, which validate once."""
    files = find_scans(write_sequence(tmp_path / "08", ["a", "b"], count=400))
    exact = load_network(weights, "cpu", precision="float32", engine="torch")
    source = Source(files=files, space=exact.card.space, sensor=exact.sensor)
    module = exact.backend.module
    overflow_in_float16(module)
    expected, _ = validate(exact, source)
    half = replace(exact.backend, precision="float16", load_module=lambda: copy.deepcopy(module))
    networks = [exact, replace(exact, backend=half)]
    store = [None, None], threading.Barrier(2, timeout=30)

    def validated(rank):
        group = Threads(rank=rank, size=2, store=store)
        row, _ = validate(networks[rank], source, group)
        return row

    with ThreadPoolExecutor(2) as pool, caplog.at_level(NOTICE):
        rows = [*pool.map(validated, range(2))]
    for row in rows:
        np.testing.assert_equal(row, expected)
    (message,) = caplog.messages
    assert "(float16, float32)" in message
