# SPDX-License-Identifier: MIT
# ruff: noqa: F811
"""Weights, their card, and the model of errors in it."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
import safetensors.torch
import torch
from rewritten_weights import rewritten
from scans import SMALL, lively, refused
from shallow_network import shallow, weights  # noqa: F401

from salsanext_cli import __version__, label_space
from salsanext_cli.core.errors import WeightsError
from salsanext_cli.core.network.card import KEY, WeightsCard
from salsanext_cli.core.network.registry import build
from salsanext_cli.core.optional_packages import extra_command
from salsanext_cli.io.label_spaces import label_space
from salsanext_cli.io.weights.card_file import read_card
from salsanext_cli.io.weights.weights import read_weights, save_weights, save_with_card

SPACE = label_space()
CARD = WeightsCard(
    {"name": "salsanext", "class_count": 20, "dropout": 0.3},
    SPACE,
    SMALL,
    recipe={"epochs": 3},
    scores={"iou_mean": 0.5},
    description="für Prüfungen",
    temperature=1.25,
    trained_on=frozenset({"0123456789abcdef01234567", "f" * 24}),
)


@pytest.fixture(scope="module")
def module(shallow):
    return lively(build(CARD.architecture))


def bias(count, dtype=torch.float32):
    """Return a bias of the logits that is beyond what float32 holds, if the type holds more."""
    value = torch.tensor(1e300 if dtype == torch.float64 else 1, dtype=torch.float64)
    return {"logits.bias": value.to(dtype).repeat(count)}


def test_round_trip_keeps_every_bit(module, tmp_path):
    save_weights(tmp_path / "w.safetensors", module, CARD)
    loaded, card = read_weights(tmp_path / "w.safetensors")
    for name, tensor in module.state_dict().items():
        assert torch.equal(loaded.state_dict()[name], tensor), name
    assert not loaded.training
    assert card.architecture == CARD.architecture
    assert card.sensor == CARD.sensor
    assert card.space.to_dict() == SPACE.to_dict()
    for name in ("recipe", "scores", "description", "temperature", "trained_on"):
        assert getattr(card, name) == getattr(CARD, name)
    assert loaded.bottom.rate == 0.3


def test_equal_weights_give_equal_files(tmp_path):
    """Several keys of metadata would be written in random order."""
    for number in range(8):
        save_weights(tmp_path / f"{number}.safetensors", torch.nn.BatchNorm1d(1), CARD)
    assert len({path.read_bytes() for path in tmp_path.iterdir()}) == 1
    again = read_card(tmp_path / "0.safetensors")
    assert replace(again, tensors_sha256="").to_metadata() == CARD.to_metadata()
    assert json.loads(again.to_metadata()[KEY])["version"] == __version__


def test_a_version_of_weights_stays_and_the_version_that_wrote_them_is_optional(tmp_path, weights):
    metadata = replace(CARD, version=5).to_metadata()
    assert WeightsCard.from_metadata(metadata, "w").version == 5
    assert json.loads(metadata[KEY])["weights_version"] == 5
    without = json.loads(CARD.to_metadata()[KEY])
    assert list(without) == [key for key in json.loads(metadata[KEY]) if key != "weights_version"]
    assert WeightsCard.from_metadata(CARD.to_metadata(), "w").version is None
    read_weights(rewritten(weights, tmp_path / "w.safetensors", lambda m, _: m.pop("version")))


def test_another_card_leaves_the_tensors_as_they_are_stored(module, tmp_path):
    source, target = tmp_path / "half.safetensors", tmp_path / "new.safetensors"
    save_weights(source, module, CARD, half=True)
    save_with_card(source, target, replace(CARD, temperature=1.75))
    old, new = safetensors.torch.load_file(source), safetensors.torch.load_file(target)
    assert {name: t.dtype for name, t in new.items()} == {name: t.dtype for name, t in old.items()}
    assert all(torch.equal(new[name], tensor) for name, tensor in old.items())
    assert read_card(target).temperature == 1.75
    assert abs(target.stat().st_size - source.stat().st_size) < 64
    save_with_card(target, target, CARD)
    assert target.read_bytes() == source.read_bytes()


def test_half_precision_is_small_close_and_keeps_large_values(tmp_path):
    module = lively(build(CARD.architecture))
    save_weights(tmp_path / "full.safetensors", module, CARD)
    module.block1.stack.fuse[2].running_var[:] = 1e6
    module.logits.weight.data[0, 0] = 1e5
    save_weights(tmp_path / "half.safetensors", module, CARD, half=True)
    half, full = ((tmp_path / f"{name}.safetensors").stat().st_size for name in ("half", "full"))
    assert half < 0.7 * full
    loaded, _ = read_weights(tmp_path / "half.safetensors")
    for name, tensor in loaded.state_dict().items():
        original = module.state_dict()[name]
        assert tensor.dtype == original.dtype
        if "running" in name:
            assert torch.equal(tensor, original)
        torch.testing.assert_close(tensor, original, rtol=1e-3, atol=1e-6)


VIEW = {"name": "s", "fov_up": 3, "fov_down": 0, "height": 1, "width": 1}


NAMED = '{"name": "salsanext", "class_count": 20, '
DAMAGED = {
    "format": ('"somebody-else-3"', "[]"),
    "architecture": (
        *(None, "[1]", '{"name": "resnet"}', '{"name": ["salsanext"]}', '{"name": "salsanext"}'),
        *('{"name": "salsanext", "class_count": -1}', NAMED + '"layers": 3}'),
        *(NAMED + '"dropout": 1.0}', NAMED + '"dropout": "x"}'),
    ),
    "label_space": ('{"labels": {}}', "[]"),
    "sensor": (
        *('{"name": "s", "fov_up": 3}', "[]", '"hdl64"'),
        json.dumps(VIEW | {"stds": [1, 1, 1, 1, 1e-40]}),
        json.dumps(VIEW | {"height": 4096, "width": 4096}),
    ),
    "temperature": (*(None, "0", "NaN", "Infinity", "1e-300", f"1{400 * '0'}", '"1"', "true"),),
    "recipe": ("[]",),
    "scores": ("3",),
    "weights_version": ("null", "0", "-1", "true", "1.5", '"5"', "[]"),
    "tensors_sha256": ("null", "1", '"x"', "[]", f'"{63 * "a"}"', f'"{64 * "A"}"'),
}
"""Keys of the card with values, as JSON, that it cannot have; None: it lacks the key."""


@pytest.mark.parametrize(("key", "value"), [(k, v) for k, each in DAMAGED.items() for v in each])
def test_damaged_metadata_is_an_error_of_the_file(weights, tmp_path, key, value):
    def change(metadata, _):
        if value is None:
            del metadata[key]
        else:
            metadata[key] = json.loads(value)

    path = rewritten(weights, tmp_path / "w.safetensors", change)
    caught = refused(WeightsError, path, read_weights, path)
    assert "\n" not in caught.value.headline


def test_tensors_that_do_not_fit_are_named(weights, tmp_path):
    variance = "block1.stack.fuse.2.running_var"
    for change, name in (
        (lambda _, t: t.pop("logits.bias"), "logits.bias"),
        (lambda _, t: t.update(spare=torch.zeros(1)), "spare"),
        (lambda _, t: t.update(bias(3)), "logits.bias"),
        (lambda _, t: t["logits.bias"].fill_(torch.nan), "logits.bias"),
        (lambda _, t: t["logits.weight"].view(-1)[5:6].fill_(torch.inf), "logits.weight"),
        (lambda _, t: t.update(bias(20, torch.float64)), "logits.bias"),
        (lambda _, t: t.update(bias(20, torch.complex64)), "logits.bias"),
        (lambda _, t: t[variance][:1].fill_(-1e-6), variance),
        (lambda m, _: m.clear(), "salsanext"),
    ):
        path = rewritten(weights, tmp_path / "w.safetensors", change)
        caught = refused(WeightsError, path, read_weights, path)
        assert name in caught.value.problem


@pytest.mark.parametrize(
    "metadata", [None, {"format": "salsanext-1"}, {KEY: "{"}, {KEY: "[]"}, {KEY: ""}]
)
def test_metadata_of_another_form_are_refused(tmp_path, metadata):
    path = tmp_path / "w.safetensors"
    path.write_bytes(safetensors.torch.save({"a": torch.zeros(1)}, metadata))
    refused(WeightsError, path, read_card, path)


@pytest.mark.parametrize("name", ["none.safetensors", ".", "model.onnx", "rubbish.safetensors"])
def test_other_files_are_refused(tmp_path, name):
    for file in ("model.onnx", "rubbish.safetensors"):
        (tmp_path / file).write_bytes(b"\x08\x08\x12\x07pytorch")
    caught = refused(WeightsError, tmp_path / name, read_weights, tmp_path / name)
    assert caught.value.hint
    assert ("export" in caught.value.hint) == (name == "model.onnx")


@pytest.mark.parametrize("name", ["rangenet53", "salsanet-dilated"])
def test_the_name_of_a_network_of_the_papers_is_no_weights_file(name):
    error = refused(WeightsError, name, read_card, Path(name)).value
    assert extra_command("paper") in error.hint
