# SPDX-License-Identifier: MIT
import json
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
import safetensors.torch
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scans import SMALL, lively, write_weights

from salsanext_cli import __version__
from salsanext_cli.classes import label_space
from salsanext_cli.errors import OutputError, WeightsError
from salsanext_cli.network.inference import load_network
from salsanext_cli.network.salsanext import SalsaNext
from salsanext_cli.network.weights import (
    WeightsCard,
    fingerprint,
    load_tensors,
    read_card,
    read_weights,
    save_weights,
)

SPACE = label_space()
CARD = WeightsCard(
    {"name": "salsanext", "class_count": 20, "dropout": 0.3},
    SPACE,
    SMALL,
    recipe={"epochs": 3},
    scores={"iou_mean": 0.5},
    description="für Prüfungen",
)


@pytest.fixture(scope="module")
def module():
    return lively(SalsaNext(20, 0.3))


def rewritten(source, target, change):
    """Copy a weights file with its metadata and tensors changed."""
    with safetensors.safe_open(source, framework="pt") as file:
        metadata = dict(file.metadata())
    tensors = safetensors.torch.load_file(source)
    change(metadata, tensors)
    target.write_bytes(safetensors.torch.save(tensors, metadata))
    return target


def test_round_trip_keeps_every_bit(module, tmp_path):
    save_weights(tmp_path / "w.safetensors", module, CARD)
    loaded, card = read_weights(tmp_path / "w.safetensors")
    for name, tensor in module.state_dict().items():
        assert torch.equal(loaded.state_dict()[name], tensor), name
    assert not loaded.training
    assert card.architecture == CARD.architecture
    assert card.sensor == CARD.sensor
    assert card.space.to_dict() == SPACE.to_dict()
    assert (card.recipe, card.scores, card.description) == (
        CARD.recipe,
        CARD.scores,
        CARD.description,
    )
    assert loaded.bottom.rate == 0.3


def test_the_metadata_says_everything_and_which_version(module, tmp_path):
    save_weights(tmp_path / "w.safetensors", module, CARD)
    with safetensors.safe_open(tmp_path / "w.safetensors", framework="pt") as file:
        metadata = file.metadata()
    assert set(metadata) == {
        *("format", "architecture", "label_space", "sensor"),
        *("recipe", "scores", "description", "version"),
    }
    assert json.loads(metadata["version"]) == __version__


def test_half_precision_is_small_close_and_keeps_large_variances(module, tmp_path):
    module = lively(SalsaNext(20))
    module.block1.stack.fuse[2].running_var[:] = 1e6
    save_weights(tmp_path / "half.safetensors", module, CARD, half=True)
    assert (tmp_path / "half.safetensors").stat().st_size < 15e6
    loaded, _ = read_weights(tmp_path / "half.safetensors")
    for name, tensor in loaded.state_dict().items():
        original = module.state_dict()[name]
        assert tensor.dtype == original.dtype
        if "running" in name:
            assert torch.equal(tensor, original)
        torch.testing.assert_close(tensor, original, rtol=1e-3, atol=1e-6)


def test_reading_does_not_alias_the_file(module, tmp_path):
    path = tmp_path / "w.safetensors"
    save_weights(path, module, CARD)
    loaded, _ = read_weights(path)
    before = loaded.logits.bias.clone()
    path.unlink()
    assert torch.equal(loaded.logits.bias, before)


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [
        ("format", "somebody-else-3", "format somebody-else-3"),
        ("architecture", None, "damaged"),
        ("architecture", "{", "damaged"),
        ("architecture", "[1]", "architecture is no table"),
        ("architecture", '{"name": "resnet"}', "architecture resnet"),
        ("architecture", '{"name": ["salsanext"]}', "architecture"),
        ("architecture", '{"name": "salsanext", "layers": 3}', "layers"),
        ("architecture", '{"name": "salsanext", "class_count": -1}', "-1"),
        ("architecture", '{"name": "salsanext", "class_count": 20, "dropout": 1.0}', "1.0"),
        ("architecture", '{"name": "salsanext", "class_count": 20, "dropout": "x"}', "x"),
        ("architecture", '{"name": "salsanext"}', "outputs for the 20 classes"),
        ("label_space", '{"labels": {}}', "label space"),
        ("label_space", "[]", "damaged"),
        ("sensor", '{"name": "s", "fov_up": 3}', "fov_down"),
        ("sensor", "[]", "damaged"),
        ("sensor", '"hdl64"', "damaged"),
        ("recipe", "[]", "damaged"),
        ("scores", "3", "damaged"),
        ("version", None, None),
    ],
)
def test_damaged_metadata_is_named(weights, tmp_path, key, value, says):
    def change(metadata, tensors):
        if value is None:
            del metadata[key]
        else:
            metadata[key] = value

    path = rewritten(weights, tmp_path / "w.safetensors", change)
    if says is None:
        read_weights(path)
        return
    with pytest.raises(WeightsError, match=says) as caught:
        read_weights(path)
    assert caught.value.subject == str(path)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda _, t: t.pop("logits.bias"), r"lacks 1 tensors, such as logits\.bias"),
        (lambda _, t: t.update(spare=torch.zeros(1)), "1 unknown tensors, such as spare"),
        (
            lambda _, t: t.update({"logits.bias": torch.zeros(3)}),
            r"logits\.bias is \(3,\).*\(20,\)",
        ),
        (lambda _, t: t["logits.bias"].fill_(torch.nan), r"logits\.bias holds .* not finite"),
        (lambda _, t: t["logits.weight"].view(-1)[5:6].fill_(torch.inf), "not finite"),
        (lambda m, _: m.clear(), "format None"),
    ],
)
def test_tensors_that_do_not_fit_are_named(weights, tmp_path, change, says):
    path = rewritten(weights, tmp_path / "w.safetensors", change)
    with pytest.raises(WeightsError, match=says) as caught:
        read_weights(path)
    assert caught.value.subject == str(path)


def test_weights_of_another_label_space_do_not_fit(weights, tmp_path):
    """Twenty outputs cannot stand for two classes."""
    small = {"labels": {0: "no", 1: "yes"}, "learning_map": {0: 0, 1: 1}}
    small["learning_map_inv"] = {0: 0, 1: 1}
    path = rewritten(
        weights,
        tmp_path / "w.safetensors",
        lambda metadata, _: metadata.update(label_space=json.dumps({"name": "two"} | small)),
    )
    with pytest.raises(WeightsError, match="20 outputs for the 2 classes of two"):
        read_weights(path)


@pytest.mark.parametrize("content", [b"", b"\0" * 4, b"hello, world, this is no such file" * 9])
def test_what_is_no_weights_file_is_refused(tmp_path, content):
    (tmp_path / "w.safetensors").write_bytes(content)
    with pytest.raises(WeightsError, match="cannot be read"):
        read_weights(tmp_path / "w.safetensors")


@pytest.mark.parametrize("share", [0.0001, 0.01, 0.5, 0.999999])
def test_a_truncated_file_is_refused(weights, tmp_path, share):
    content = weights.read_bytes()
    path = tmp_path / "w.safetensors"
    path.write_bytes(content[: int(len(content) * share)])
    with pytest.raises(WeightsError):
        read_weights(path)


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_a_flipped_byte_in_the_header_is_refused_or_harmless(weights, tmp_path_factory, data):
    content = weights.read_bytes()
    header = 8 + int.from_bytes(content[:8], "little")
    place = data.draw(st.integers(0, header - 1))
    byte = data.draw(st.integers(0, 255))
    path = tmp_path_factory.mktemp("flipped") / "w.safetensors"
    path.write_bytes(content[:place] + bytes([byte]) + content[place + 1 : header] + b"\0" * 64)
    with suppress(WeightsError):
        read_card(path)


def test_a_missing_file_and_a_folder_are_refused(tmp_path):
    with pytest.raises(WeightsError, match="no such file"):
        read_weights(tmp_path / "none.safetensors")
    with pytest.raises(WeightsError, match="cannot be read"):
        read_weights(tmp_path)


def test_weights_that_cannot_be_written(module, tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="cannot be written"):
        save_weights(tmp_path / "file" / "w.safetensors", module, CARD)


def test_saving_replaces_whole_files_only(module, tmp_path, monkeypatch):
    path = tmp_path / "w.safetensors"
    path.write_bytes(b"old")

    class Stop(Exception):  # noqa: N818
        pass

    def fail(*_):
        raise Stop

    monkeypatch.setattr(safetensors.torch, "save", fail)
    with pytest.raises(Stop):
        save_weights(path, module, CARD)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_loading_tensors_casts_to_float32():
    module = SalsaNext(2)
    tensors = {name: t.double() for name, t in lively(SalsaNext(2)).state_dict().items()}
    load_tensors(module, tensors, "here")
    assert module.logits.weight.dtype == torch.float32
    assert module.context[0].local[2].num_batches_tracked.dtype == torch.int64


def test_a_fingerprint_follows_the_file(tmp_path):
    """A network trained further under the same name is another network."""
    import hashlib

    path = tmp_path / "w.safetensors"
    for seed in (0, 1):
        write_weights(path, seed=seed)
        assert fingerprint(path) == hashlib.sha256(path.read_bytes()).hexdigest()


def test_a_card_of_another_sensor_gives_other_inputs(weights):
    ours = load_network(weights, "cpu")
    other = load_network(weights, "cpu", replace(SMALL, means=(0.0,) * 5))
    channels = np.ones((5, 16, 128), np.float32)
    assert not torch.equal(ours.input(channels), other.input(channels))
    assert ours.sensor == SMALL
    assert other.card.sensor == SMALL
