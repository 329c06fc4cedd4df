# SPDX-License-Identifier: MIT
"""Behaviour that the stages of tuning share."""

import logging
from dataclasses import replace

import numpy as np
import pytest
import torch
from safetensors.torch import load_file
from scans import write_sequence

from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.errors import LabelError, OutputError
from salsanext_cli.formats.kitti import write_labels
from salsanext_cli.network.card import read_card
from salsanext_cli.network.weights import read_weights, save_weights
from salsanext_cli.options import ScanSelection
from salsanext_cli.stages.tune import tune as tune_part


@pytest.fixture
def tune(world, target):
    """Return a function that tunes to a data set quickly, and gives the result."""

    def call(target=target, **changes):
        given = {"settings": world.network, **changes}
        return tune_part("temperature", world.data, target, **given)

    return call


def test_all_else_stays_bit_for_bit_and_as_small(tune, world, target, tmp_path):
    source = tmp_path / "source.safetensors"
    save_weights(source, *read_weights(world.network.weights), half=True)
    tune(settings=NetworkSettings(source, "cpu", engine="torch"))
    old, new = load_file(source), load_file(target)
    assert {name: t.dtype for name, t in old.items()} == {name: t.dtype for name, t in new.items()}
    for name, tensor in old.items():
        assert torch.equal(tensor, new[name]), name
    assert abs(target.stat().st_size - source.stat().st_size) < 128
    before, after = read_card(source), read_card(target)
    kept = replace(after, temperature=before.temperature).to_metadata()
    assert kept == before.to_metadata() != after.to_metadata()


def test_progress_and_selection(tune, world, caplog):
    write_sequence(world.data / "sequences/08", [f"{i:06d}" for i in range(2, 5)], seed=2)
    seen, selection = [], ScanSelection(split="valid", limit=3)
    with caplog.at_level(logging.INFO, "salsanext_cli.training.tuning"):
        assert tune(selection=selection, progress=lambda *n: seen.append(n))["scans"] == 3
    assert seen == [(number, 3) for number in range(1, 4)]
    named = [message[:9] for message in caplog.messages if message.startswith("08/")]
    assert named == [f"08/00000{i}" for i in (0, 2, 4)]


def test_a_target_that_cannot_be_written_is_noticed_before_the_work(tune, target, tmp_path):
    target.write_bytes(b"precious")
    for place in (tmp_path / "w.pt", target, target / "w.safetensors"):
        with pytest.raises(OutputError):
            tune(place, progress=pytest.fail)
    assert target.read_bytes() == b"precious"


@pytest.mark.parametrize(
    ("raw", "says"),
    [
        (0, "no point is of a class that counts"),
        (1234, r"unknown label ids 1234"),
        (None, r"00000\d\.label · no such file"),
    ],
)
def test_labels_that_cannot_be_learnt_from(tune, world, target, raw, says):
    for path in (world.data / "sequences/08/labels").iterdir():
        if raw is None:
            path.unlink()
        else:
            write_labels(path, np.full(1500, raw, np.uint32))
    with pytest.raises(LabelError, match=says):
        tune()
    assert not target.exists()


def test_labels_of_other_classes(tune, world):
    (world.data / "labels.yaml").write_text(
        "labels: {0: none, 10: car, 40: road}\nlearning_map: {0: 0, 10: 1, 40: 2}\n"
        "learning_map_inv: {0: 0, 1: 10, 2: 40}\nsplit: {valid: ['08']}\n"
    )
    with pytest.raises(LabelError, match="labels in the classes of"):
        tune()
