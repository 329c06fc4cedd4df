# SPDX-License-Identifier: MIT
# ruff: noqa: F811
"""Weights, their card, and the model of errors in it."""

import json
import math
import os
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numba
import numpy as np
import pytest
import safetensors.torch
import torch
from scans import SMALL, lively, refused
from shallow import shallow, weights  # noqa: F401

from salsanext_cli import __version__, label_space, sensor
from salsanext_cli.commands.stages.models import describe_weights
from salsanext_cli.core.errors import WeightsError
from salsanext_cli.core.network.card import KEY, WeightsCard
from salsanext_cli.core.network.error_model import ErrorModel, last_values
from salsanext_cli.core.network.registry import build
from salsanext_cli.core.network.tuned_settings import KEY_OF
from salsanext_cli.core.plain_data import plain
from salsanext_cli.core.sensors.sensor import FittedView
from salsanext_cli.io.label_spaces import label_space
from salsanext_cli.io.weights import tensor_digest
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


def rewritten(source, target, change):
    """Copy a weights file with changed metadata and tensors, which have no digest."""
    with safetensors.safe_open(source, framework="pt") as file:
        metadata = json.loads(file.metadata()[KEY])
    del metadata["tensors_sha256"]
    tensors = safetensors.torch.load_file(source)
    change(metadata, tensors)
    target.write_bytes(safetensors.torch.save(tensors, {KEY: json.dumps(metadata)}))
    return target


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


def test_a_changed_byte_of_a_tensor_is_noticed(weights, tmp_path):
    """The lowest byte of a number changes it by less than any check of values could see."""
    content, path = weights.read_bytes(), tmp_path / "w.safetensors"
    start = 8 + int.from_bytes(content[:8], "little")
    draw = np.random.default_rng(1)
    for place in (start, len(content) - 1, *draw.integers(start, len(content), 6).tolist()):
        damaged = bytearray(content)
        damaged[place] ^= 1
        path.write_bytes(damaged)
        for read in (read_weights, describe_weights, lambda path: copied(path, tmp_path / "c")):
            refused(WeightsError, path, read, path)
    path.write_bytes(content)
    read_weights(path)
    copied(path, tmp_path / "c.safetensors")


def copied(source, target):
    """Write the tensors of a weights file with the same card."""
    save_with_card(source, target, read_card(source))


def test_the_digest_is_of_the_tensors_only(weights, tmp_path):
    """Names count: two tensors of one shape that change places are other tensors."""
    stored = read_card(weights).tensors_sha256
    assert describe_weights(weights).to_dict()["tensors_sha256"] == stored
    tuned, path = tmp_path / "tuned.safetensors", tmp_path / "w.safetensors"
    save_with_card(weights, tuned, replace(read_card(weights), temperature=1.5))
    assert read_card(tuned).tensors_sha256 == stored
    assert tuned.read_bytes() != weights.read_bytes()

    def swap(metadata, tensors):
        metadata["tensors_sha256"] = stored
        tensors.update({a: tensors[b], b: tensors[a]})

    a, b = (f"block1.stack.fuse.2.{name}" for name in ("weight", "bias"))
    caught = refused(WeightsError, path, read_weights, rewritten(weights, path, swap))
    assert "SHA-256" in caught.value.problem


def test_a_file_is_hashed_once_as_long_as_it_stays(weights, tmp_path, monkeypatch):
    path, digests = tmp_path / "w.safetensors", []
    path.write_bytes(weights.read_bytes())
    compute = tensor_digest._digest
    monkeypatch.setattr(tensor_digest, "_digest", lambda f: digests.append(1) or compute(f))
    for _ in range(3):
        read_weights(path)
    assert len(digests) == 1
    os.utime(path, ns=(0, 0))
    read_weights(path)
    assert len(digests) == 2


def test_files_without_a_digest_are_read(weights, tmp_path):
    path = rewritten(weights, tmp_path / "w.safetensors", lambda *_: None)
    assert describe_weights(path).to_dict()["tensors_sha256"] is None
    read_weights(path)


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


def layers(*sizes: int):
    random = np.random.default_rng(len(sizes))
    return [
        (random.normal(size=size).astype("f4"), random.normal(size=size[1]).astype("f4"))
        for size in pairwise(sizes)
    ]


def model() -> ErrorModel:
    return ErrorModel(("a", "b", "c"), layers(3, 4, 2, 1), {"auroc": 0.9})


def by_products(rows, given):
    for place, (weight, bias) in enumerate(given):
        rows = rows.astype("f8") @ weight + bias
        if place < len(given) - 1:
            rows = np.where(rows < 0, 0, rows)
    return rows[:, 0]


@pytest.mark.parametrize("threads", [2, 5])
@pytest.mark.parametrize("sizes", [(9, 16, 16, 1), (3, 1)])
@pytest.mark.parametrize("count", [0, 1, 255, 257, 1300])
def test_any_sizes_on_any_number_of_threads(count, sizes, threads, monkeypatch):
    monkeypatch.setattr("salsanext_cli.core.compiled.MIN_SLICE_ITEMS", 100)
    rows = np.random.default_rng(count).normal(size=(count, sizes[0])).astype("f4")
    rows[count // 2 : count // 2 + 1, -1] = np.nan
    given = layers(*sizes)
    monkeypatch.setitem(vars(numba.config), "NUMBA_NUM_THREADS", 1)
    expected = last_values(rows, given)
    np.testing.assert_allclose(expected, by_products(rows, given), rtol=1e-4, atol=1e-5)
    assert np.isnan(expected).sum() == min(count, 1)
    monkeypatch.setitem(vars(numba.config), "NUMBA_NUM_THREADS", threads)
    for form in (rows, rows.astype("f8"), np.asfortranarray(rows), np.repeat(rows, 2, 0)[::2]):
        np.testing.assert_array_equal(last_values(form, given), expected)


def test_a_probability_is_the_logistic_function_of_the_last_value() -> None:
    found, features = model(), np.random.default_rng(1).normal(size=(7, 3)).astype("f4")
    expected = 1 / (1 + np.exp(-by_products(features, found.layers)))
    np.testing.assert_allclose(found.probability(features), expected, atol=1e-6)
    sure = ErrorModel(("a",), [(np.array([[1]], "f4"), np.array([0], "f4"))])
    found = sure.probability(np.array([[-1e9], [0], [1e9]], "f4"))
    assert found.tolist() == pytest.approx([0, 0.5, 1], abs=1e-9)
    assert ((found >= 0) & (found <= 1)).all()


def card(error: ErrorModel | None) -> WeightsCard:
    architecture = {"name": "salsanext", "class_count": 20}
    return WeightsCard(architecture, label_space(), sensor("hdl64"), error=error)


def test_a_card_keeps_it() -> None:
    wanted = model()
    metadata = card(wanted).to_metadata()
    found = WeightsCard.from_metadata(metadata, "w").error
    assert (found.features, found.scores) == (wanted.features, wanted.scores)
    features = np.random.default_rng(1).normal(size=(50, 3)).astype("f4")
    np.testing.assert_allclose(found.probability(features), wanted.probability(features), rtol=1e-5)
    assert WeightsCard.from_metadata(metadata, "w").to_metadata() == metadata
    # A card without one is what it was before there were any.
    assert "error" not in json.loads(card(None).to_metadata()[KEY])
    assert WeightsCard.from_metadata(card(None).to_metadata(), "w").error is None


def test_damaged_ones_are_one_line() -> None:
    for damage in (
        lambda error: error.update(layers=[]),
        lambda error: error.update(features=["a"]),
        lambda error: error["layers"].pop(),
        lambda error: error["layers"][0][1].__setitem__(0, math.nan),
        lambda error: error["layers"][0][1].__setitem__(0, "x"),
        lambda error: error.pop("scores"),
    ):
        values = json.loads(card(model()).to_metadata()[KEY])
        damage(values["error"])
        for error in (values["error"], None):
            with refused(WeightsError, "w"):
                WeightsCard.from_metadata({KEY: json.dumps(values | {"error": error})}, "w")


RISK = {"kind": "error", "threshold": 0.2, "at_most": 0.1, "confidence": None}
RISK |= {"scans": 12, "sequences": ["00"]}
LINE = {"slope": 1.0, "offset": 0.1, "deviation": 0.04}


@pytest.mark.parametrize(("part", "whole"), [("risk", RISK), ("accuracy", LINE)])
def test_numbers_that_a_statement_rests_on_are_all_there(part, whole) -> None:
    values = json.loads(card(None).to_metadata()[KEY])
    read = WeightsCard.from_metadata({KEY: json.dumps(values | {part: whole})}, "w")
    assert {name: plain(getattr(getattr(read, part), name)) for name in whole} == whole
    broken = [{k: v for k, v in whole.items() if k != name} for name in whole]
    numbers = [name for name in whole if isinstance(whole[name], float)]
    broken += [whole | {name: value} for name in numbers for value in ("x", math.nan, None)]
    for each in broken:
        with pytest.raises(WeightsError):
            WeightsCard.from_metadata({KEY: json.dumps(values | {part: each})}, "w")


def test_thresholds_with_the_keys_of_early_versions() -> None:
    """Fields of view are read; thresholds of classes would accept labels that they rejected."""
    values = json.loads(card(None).to_metadata()[KEY])

    def read(**risk) -> WeightsCard:
        return WeightsCard.from_metadata({KEY: json.dumps(values | {"risk": RISK | risk})}, "w")

    views = [FittedView.of(sensor(name)) for name in ("hdl64", "hdl64-512")]
    first, second = map(plain, views)
    assert read(view=first, other_views=[second]).risk.views == tuple(views)
    assert read(view=None, other_views=[], classes={}).risk == read().risk
    early = {"--min-range": 1.0, "--sensor": {"name": "hdl64", "width": 512}}
    later = {"--min-range": 1.0, "--sensor": {"name": "hdl64"}, "--width": 512}
    assert read(settings=early).risk.settings == later
    assert {*later} <= {*KEY_OF.values()}
    for risk in ({"classes": {"car": 0.1}}, {"view": 5}):
        with pytest.raises(WeightsError):
            read(**risk)
    for other in ("x", 5, [RISK]):
        with pytest.raises(WeightsError):
            WeightsCard.from_metadata({KEY: json.dumps(values | {"risk": other})}, "w")


@pytest.mark.parametrize("name", ["rangenet53", "salsanet-dilated"])
def test_the_name_of_a_network_of_the_papers_is_no_weights_file(name):
    error = refused(WeightsError, name, read_card, Path(name)).value
    assert "examples/paper_networks" in error.hint
