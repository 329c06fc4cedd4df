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

CHANGED = {"temperature": "temperature", "dropout": "architecture"}
"""Field of the card that a tuning changes."""


@pytest.fixture(params=CHANGED)
def what(request):
    return request.param


@pytest.fixture
def tune(world, target, what):
    """Return a function that tunes to a data set quickly, and gives the result."""
    few = {"samples": 2, "steps": 2} if what == "dropout" else {}

    def call(target=target, **changes):
        return tune_part(what, world.data, target, **{"network": world.network, **few, **changes})

    return call


def test_all_else_stays_bit_for_bit_and_as_small(tune, what, world, target, tmp_path):
    source = tmp_path / "source.safetensors"
    save_weights(source, *read_weights(world.network.weights), half=True)
    tune(network=NetworkSettings(source, "cpu", engine="torch"))
    old, new = load_file(source), load_file(target)
    assert {name: t.dtype for name, t in old.items()} == {name: t.dtype for name, t in new.items()}
    for name, tensor in old.items():
        assert torch.equal(tensor, new[name]), name
    assert abs(target.stat().st_size - source.stat().st_size) < 128
    before, after = read_card(source), read_card(target)
    kept = {CHANGED[what]: getattr(before, CHANGED[what])}
    assert replace(after, **kept).to_metadata() == before.to_metadata() != after.to_metadata()


def test_it_is_the_same_every_time(tune, world, target):
    first = tune()
    content = target.read_bytes()
    assert tune(overwrite=True) == first
    assert target.read_bytes() == content


def test_progress_and_selection(tune, what, world, caplog):
    write_sequence(world.data / "sequences/08", [f"{i:06d}" for i in range(2, 5)], seed=2)
    seen, selection = [], ScanSelection(split="valid", limit=3)
    with caplog.at_level(logging.INFO, "salsanext_cli.training.tuning"):
        assert tune(selection=selection, progress=lambda *n: seen.append(n))["scans"] == 3
    count = 6 if what == "dropout" else 3
    assert seen == [(number, count) for number in range(1, count + 1)]
    named = [message[:9] for message in caplog.messages if message.startswith("08/")]
    assert named == [f"08/00000{i}" for i in (0, 2, 4)]


def test_a_target_that_cannot_be_written_is_noticed_before_the_work(tune, target, tmp_path):
    target.write_bytes(b"precious")
    (tmp_path / "folder.safetensors").mkdir()
    for place, overwrite, words in (
        (tmp_path / "w.pt", False, r"suffix \.pt"),
        (target, False, "exists"),
        (target / "w.safetensors", False, "cannot be written"),
        (tmp_path / "folder.safetensors", True, "is a folder"),
    ):
        seen = []
        with pytest.raises(OutputError, match=words):
            tune(place, overwrite=overwrite, progress=seen.append)
        assert not seen
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
