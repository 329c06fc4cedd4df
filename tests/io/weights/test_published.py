# SPDX-License-Identifier: MIT
"""Checkpoints as the published code saves them, and files that only look like it."""

import logging
import os
import tracemalloc
from collections import OrderedDict, defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from narrow_network import NARROW, narrow_salsanext
from other_program import require_kept
from scans import lively, refused

from salsanext_cli import load_network
from salsanext_cli.commands.stages import import_weights as stage
from salsanext_cli.commands.stages.import_weights import import_weights
from salsanext_cli.core.errors import OutputError, WeightsError
from salsanext_cli.core.network.card import FittedParts, RiskThreshold
from salsanext_cli.core.network.salsanext import SalsaNext
from salsanext_cli.io.sensors import sensor
from salsanext_cli.io.weights import published
from salsanext_cli.io.weights.card_file import read_card
from salsanext_cli.io.weights.published import read_published
from salsanext_cli.io.weights.weights import load_tensors, read_weights, save_with_card


def published_names():
    """Return the published name of each of ours, by turning the tables round."""
    groups = [
        *(("downCntx" + n, f"context.{i}", published.CONTEXT_UNITS) for i, n in enumerate(" 23")),
        *((f"resBlock{n}", f"block{n}", published.RESIDUAL_UNITS) for n in range(1, 6)),
        *((f"upBlock{n}", f"up{n}.stack", published.UP_UNITS) for n in range(1, 5)),
    ]
    return {
        f"{ours}.{unit}": f"{theirs.strip()}.{key}"
        for theirs, ours, units in groups
        for key, unit in units.items()
    } | {"logits": "logits"}


@pytest.fixture(scope="module")
def module():
    return lively(SalsaNext(20, **NARROW))


@pytest.fixture
def narrow():
    """Have as few channels in the network that is called salsanext."""
    with narrow_salsanext():
        yield


@pytest.fixture(scope="module")
def state(module):
    """Return a state dictionary under published names, without prefix."""
    names = published_names()
    renamed = {}
    for key, tensor in module.state_dict().items():
        place, leaf = key.rsplit(".", 1)
        renamed[f"{names[place]}.{leaf}"] = tensor
    return renamed


FEW = {
    "logits.bias": torch.arange(3.0),
    "upBlock1.bn4.num_batches_tracked": torch.tensor(7),
    "downCntx2.conv1.weight": torch.ones(2, 2, 1, 1),
}
FEW_OURS = ("logits.bias", "up1.stack.fuse.2.num_batches_tracked", "context.1.shortcut.0.weight")


def save(path, content):
    torch.save(content, path)
    return path


def test_a_whole_checkpoint(tmp_path, state, module):
    path = save(tmp_path / "SalsaNext", {"epoch": 7, "state_dict": state})
    fresh = SalsaNext(20, **NARROW)
    load_tensors(fresh, read_published(path), path)
    for name, tensor in module.state_dict().items():
        assert torch.equal(fresh.state_dict()[name], tensor), name


@pytest.mark.parametrize("prefix", ["", "module."])
@pytest.mark.parametrize("wrapped", [True, False], ids=["wrapped", "bare"])
def test_prefix_and_wrapping_do_not_matter(tmp_path, prefix, wrapped):
    tensors = OrderedDict((prefix + name, tensor) for name, tensor in FEW.items())
    content = {"epoch": 7, "state_dict": tensors, "info": {"best": 0.5}} if wrapped else tensors
    found = read_published(save(tmp_path / "SalsaNext", content))
    assert tuple(found) == FEW_OURS
    for read, written in zip(found.values(), FEW.values(), strict=True):
        assert torch.equal(read, written)


def test_files_that_are_no_checkpoints(tmp_path):
    for content, part in (
        ({"state_dict": {"logits.weight": "text"}}, "state_dict"),
        ({"model": {"x": torch.zeros(1)}}, "state_dict"),
        ({"state_dict": {**FEW, "logits.weight": "text"}}, "logits.weight"),
        ({"state_dict": {**FEW, "logits.weight": torch.ones(2).to_sparse()}}, "logits.weight"),
        ({"state_dict": {**FEW, "logits.weight": Path()}}, "logits.weight"),
        ({"state_dict": {"unheard.of.weight": torch.zeros(1)}}, "unheard.of.weight"),
    ):
        path = save(tmp_path / "SalsaNext", content)
        caught = refused(WeightsError, path, read_published, path)
        assert part in caught.value.problem


FORMS = pytest.mark.parametrize("as_zip", [True, False], ids=["zip", "legacy"])


@FORMS
def test_what_else_a_checkpoint_holds_is_ignored(tmp_path, as_zip):
    """The published code saves the state of its schedulers, whose objects torch refuses."""
    model = torch.nn.Linear(3, 2)
    optimiser = torch.optim.SGD(model.parameters(), 0.1, momentum=0.9)
    model(torch.ones(1, 3)).sum().backward()
    optimiser.step()
    schedulers = [
        torch.optim.lr_scheduler.CyclicLR(optimiser, 0.01, 0.1),
        torch.optim.lr_scheduler.ExponentialLR(optimiser, 0.9),
    ]
    others = {
        "kind": dict,
        "by": defaultdict(dict, {1: {}}),
        "place": Path("x"),
        "score": np.float64(0.5),
    }
    content = {"state_dict": FEW, "scheduler": {"last": schedulers[1]}, "others": others}
    path = tmp_path / "SalsaNext"
    torch.save(content, path, _use_new_zipfile_serialization=as_zip)
    assert tuple(read_published(path)) == FEW_OURS


class Touches:
    """Pickles as a call that makes a file."""

    def __init__(self, file):
        self.file = file

    def __reduce__(self):
        return os.system, (f"touch {self.file}",)


@FORMS
def test_nothing_in_a_file_is_run(tmp_path, as_zip):
    proof, path = tmp_path / "touched", tmp_path / "SalsaNext"
    content = {"state_dict": FEW, "x": Touches(proof)}
    torch.save(content, path, _use_new_zipfile_serialization=as_zip)
    with pytest.raises(WeightsError) as caught:
        read_published(path)
    assert "posix.system" in caught.value.problem
    assert not proof.exists()
    torch.load(path, weights_only=False)
    assert proof.exists(), "the attack would not have worked"


OTHERS = (b"", b"no checkpoint", b"PK\x03\x04", bytes(100), b"\x08\x08\x12\x07pytorch" * 9, None)


@pytest.mark.parametrize("content", OTHERS)
def test_rubbish_is_refused(tmp_path, content):
    path = tmp_path / "SalsaNext"
    cut_off = save(path, {"state_dict": FEW}).read_bytes()[:-300]
    path.write_bytes(cut_off if content is None else content)
    refused(WeightsError, path, read_published, path)


def test_a_damaged_length_reserves_no_memory(tmp_path):
    path = tmp_path / "SalsaNext"
    path.write_bytes(b"X\xff\xff\xff\x7f" + bytes(100))
    tracemalloc.start()
    try:
        with pytest.raises(WeightsError):
            read_published(path)
        assert tracemalloc.get_traced_memory()[1] < 1 << 24
    finally:
        tracemalloc.stop()


@pytest.fixture
def checkpoint(tmp_path, state, narrow):
    return save(tmp_path / "SalsaNext", {"state_dict": state})


def test_ours_are_stored_again_in_half_the_size(weights, tmp_path):
    tuned, target = tmp_path / "tuned.safetensors", tmp_path / "half.safetensors"
    save_with_card(weights, tuned, replace(read_card(weights), temperature=1.75))
    card = import_weights(tuned, target, half=True, description="halved")
    assert (card.description, card.temperature) == ("halved", 1.75)
    assert target.stat().st_size < 0.51 * weights.stat().st_size
    assert read_card(target).to_metadata() == card.to_metadata()


@pytest.mark.parametrize("halved_before", [False, True])
def test_tensors_that_change_in_half_lose_their_threshold(narrow_weights, tmp_path, halved_before):
    source, target = tmp_path / "tuned.safetensors", tmp_path / "half.safetensors"
    weights = narrow_weights
    if halved_before:
        import_weights(weights, target, half=True)
        weights = target
    risk = RiskThreshold("error", 0.2, 0.1, None, 20, ("00",))
    card = read_card(weights)
    narrow = {512: FittedParts(risk=risk)}
    card = replace(card, risk=risk, widths=(card.sensor.width, 512), parts_of_widths=narrow)
    save_with_card(weights, source, card)
    halved = import_weights(source, target, half=True, overwrite=True)
    expected = risk if halved_before else None
    assert (halved.risk, halved.parts_of_widths[512].risk) == (expected, expected)
    unchanged = import_weights(source, target, description="the same", overwrite=True)
    assert unchanged.risk == unchanged.parts_of_widths[512].risk == risk


@pytest.mark.parametrize("is_of_default_width", [True, False])
def test_weights_for_another_sensor_lose_their_threshold(
    narrow_weights, tmp_path, caplog, is_of_default_width
):
    caplog.set_level(logging.INFO)
    source, target = tmp_path / "tuned.safetensors", tmp_path / "other.safetensors"
    risk = RiskThreshold("error", 0.2, 0.1, None, 20, ("00",))
    card = read_card(narrow_weights)
    if is_of_default_width:
        tuned = replace(card, risk=risk)
    else:
        narrow = {512: FittedParts(risk=risk)}
        tuned = replace(card, widths=(card.sensor.width, 512), parts_of_widths=narrow)
    save_with_card(narrow_weights, source, tuned)
    other = import_weights(source, target, sensor=sensor("hdl32"))
    assert other.risk is None
    assert other.parts_of_widths == {}
    assert "`tune risk`" in caplog.text


def test_a_file_that_was_written_meanwhile_is_kept(checkpoint, tmp_path):
    target = tmp_path / "w.safetensors"

    def import_checkpoint(overwrite):
        import_weights(checkpoint, target, overwrite=overwrite)

    require_kept(stage, target, import_checkpoint)


def test_an_existing_target_is_replaced_only_by_overwriting(checkpoint, tmp_path):
    target = tmp_path / "w.safetensors"
    target.write_bytes(b"precious")
    for existing in (target, tmp_path / "w.pt"):
        refused(OutputError, existing, import_weights, checkpoint, existing)
    assert target.read_bytes() == b"precious"
    import_weights(checkpoint, target, overwrite=True)
    assert read_weights(target)


@pytest.mark.usefixtures("narrow")
def test_a_checkpoint_without_usable_outputs_is_refused(tmp_path, state):
    for bias, found in (
        ({"logits.bias": torch.ones(5)}, " 5 "),
        ({"logits.bias": torch.tensor(3.0)}, " 1 "),
        ({}, "logits"),
    ):
        others = {name: tensor for name, tensor in state.items() if name != "logits.bias"}
        path = save(tmp_path / "SalsaNext", {"state_dict": others | bias})
        with pytest.raises(WeightsError) as caught:
            import_weights(path, tmp_path / "w.safetensors")
        assert found in caught.value.problem
        assert caught.value.expected.startswith("20")


# The published weights, against outputs of the published implementation


@pytest.mark.real
def test_probabilities_are_the_published_ones(golden, tmp_path):
    import_weights(golden / "SalsaNext", tmp_path / "published.safetensors")
    image = torch.from_numpy(np.load(golden / "network_input.npy").astype(np.float32))
    expected = np.load(golden / "network_probabilities_every16th_column.npy")
    with torch.inference_mode():
        logits = load_network(tmp_path / "published.safetensors", "cpu").module(image[None])
    probabilities = torch.softmax(logits, dim=1)[0, :, :, ::16].numpy()
    assert np.abs(probabilities - expected).max() < 1e-4
    assert len(np.unique(expected.argmax(0))) > 3
