# SPDX-License-Identifier: MIT
"""Error model and estimated accuracy of weights that were trained from others without folds."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from evaluation_runs import run_of
from scans import SMALL, write_sequence, write_weights
from shallow_network import shallow  # noqa: F401
from tiny_network import TinyNetwork
from world import World

from salsanext_cli import LabelSpace, label_space, load_network, project, read_labels, read_scan
from salsanext_cli.commands.stages.models import describe_weights
from salsanext_cli.commands.stages.predict import predict_scans
from salsanext_cli.commands.stages.train import TrainResult, train
from salsanext_cli.core.network.card import AccuracyLine, WeightsCard
from salsanext_cli.core.network.error_model import ErrorModel
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.uncertainty.error_features import FEATURES
from salsanext_cli.io.files.reading import fingerprint
from salsanext_cli.io.weights.card_file import read_card
from salsanext_cli.io.weights.weights import save_weights, save_with_card
from salsanext_cli.runs.results.folder_names import ERROR
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.training.recipe import Recipe

MODEL = ErrorModel(
    features=FEATURES, layers=[(np.full((9, 1), 0.1, "f4"), np.zeros(1, "f4"))], scores={"folds": 5}
)
LINE = AccuracyLine(slope=1.25, offset=0.5, deviation=0.04)
ONCE = Recipe(epochs=1, batch=2, crop_width=32, learning_rate=1e-3, average=0.5)


@pytest.fixture
def start(tmp_path: Path, tiny_training: None) -> Path:
    """Weights with a version, an error model and a line of the estimated accuracy."""
    path = tmp_path / "start.safetensors"
    card = WeightsCard({"name": "salsanext", "class_count": 20}, label_space(), SMALL, version=5)
    card = replace(card, temperature=1.3, error=MODEL, accuracy=LINE)
    save_weights(path, TinyNetwork(), card)
    return path


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """Three scans to train on and two to validate."""
    write_sequence(tmp_path / "data/sequences/00", ["0", "1", "2"], count=600)
    write_sequence(tmp_path / "data/sequences/08", ["0", "1"], count=600, seed=1)
    return tmp_path / "data"


def go(data: Path, run: Path, weights: Path, recipe: Recipe = ONCE) -> TrainResult:
    return train(data, run, recipe=recipe, device="cpu", weights=weights)


def mean_confidences(weights: Path, data: Path, *temperatures: float) -> list[float]:
    """Return the mean largest probability of the labelled points of sequence 08."""
    network, largest = load_network(weights, "cpu", engine="torch"), [[] for _ in temperatures]
    space = label_space()
    for file in find_scans(data, ["08"]):
        image = project(read_scan(file.path), network.sensor)
        logits = network.logits(image).reshape(20, -1)
        scored = space.scored[space.to_train(read_labels(file.label_path))]
        pixels = image.pixel_of_point[scored & (image.pixel_of_point >= 0)]
        for values, temperature in zip(largest, temperatures, strict=True):
            powers = np.exp(logits[:, pixels].astype("f8") / temperature)
            values.append((powers / powers.sum(axis=0)).max(axis=0))
    return [float(np.concatenate(values).mean()) for values in largest]


def test_validated_weights_inherit_both_at_another_temperature(data, start, tmp_path, caplog):
    caplog.set_level(NOTICE)
    result = go(data, tmp_path / "run", start)
    name = f"default weights version 5 (SHA-256 {fingerprint(start)[:16]})"
    card = read_card(result.best)
    assert card.version is None
    assert card.recipe["initial"] == name
    parts = f"error model and estimated accuracy of {name}"
    assert card.inherited() == parts
    assert [text for text in caplog.messages if text.startswith("inherited: ")] == [
        f"inherited: {parts}; fit a model with `salsanext tune error`"
    ]
    # The error model describes the softmax that it was fitted to.
    marked = replace(MODEL, temperature=1.3, scores={"inherited_from": name, "folds": 5})
    assert card.error.to_dict() == marked.to_dict()
    # At the confidence by the temperature of the validation, the line gives the same accuracy.
    assert card.temperature == pytest.approx(result.rows[-1]["temperature"])
    assert card.temperature != 1.3
    old, new = mean_confidences(result.best, data, 1.3, card.temperature)
    logits = [np.log(share / (1 - share)) for share in (old, new)]
    assert (card.accuracy.inherited_from, card.accuracy.slope) == (name, 1.25)
    expected = 1.25 * logits[0] + 0.5
    assert 1.25 * logits[1] + card.accuracy.offset == pytest.approx(expected, abs=1e-4)
    # Weights trained from them name the weights that both were fitted to.
    again = read_card(go(data, tmp_path / "again", result.best).best)
    assert again.inherited() == parts
    assert again.recipe["initial"] == f"best.safetensors (SHA-256 {fingerprint(result.best)[:16]})"


def test_a_single_scan_leaves_the_temperature_and_the_line(data, start, tmp_path):
    shutil.rmtree(data / "sequences/08")
    for stem in ("1", "2"):
        (data / f"sequences/00/velodyne/{stem}.bin").unlink()
        (data / f"sequences/00/labels/{stem}.label").unlink()
    card = read_card(go(data, tmp_path / "run", start, ONCE.with_changes(folds=2)).best)
    assert card.temperature == 1.3
    assert card.error.temperature in (None, 1.3)
    assert replace(card.accuracy, inherited_from=None) == LINE


def test_weights_for_other_classes_inherit_nothing(data, start, tmp_path, caplog):
    caplog.set_level(NOTICE)
    known = label_space().to_dict()
    named = known | {"labels": {**known["labels"], 10: "automobile"}}
    (data / "labels.yaml").write_text(json.dumps(LabelSpace.from_dict(named, "own").to_dict()))
    card = read_card(go(data, tmp_path / "run", start).best)
    assert (card.error, card.accuracy, card.inherited()) == (None, None, "")
    (message,) = [text for text in caplog.messages if "inherited" in text]
    assert message.startswith("not inherited, ")
    # Errors by other features cannot be used.
    caplog.clear()
    (data / "labels.yaml").unlink()
    features = ("something else", *FEATURES[1:])
    other = replace(read_card(start), error=replace(MODEL, features=features))
    save_with_card(start, start, other)
    assert read_card(go(data, tmp_path / "other", start).best).error is None
    assert "not inherited" in caplog.text


@pytest.mark.usefixtures("one_step_fits")
def test_weights_without_either_have_no_heirs_and_no_notice(data, start, tmp_path, caplog):
    caplog.set_level(NOTICE)
    save_with_card(start, start, replace(read_card(start), error=None, accuracy=None))
    shutil.rmtree(data / "sequences/08")
    recipe = ONCE.with_changes(folds=2)
    card = read_card(go(data, tmp_path / "run", start, recipe).best)
    assert (card.error, card.accuracy) == (None, None)
    assert "inherited" not in caplog.text


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return shallow weights that are confident, with labels of several classes."""
    return write_weights(tmp_path_factory.mktemp("shallow") / "random.safetensors", seed=9)


@pytest.fixture
def world(world: World) -> World:
    """Return the world with the sensor of its scans: nothing here depends on a fit."""
    return world.unfitted()


@pytest.fixture
def heirs(world: World) -> World:
    """Have the weights of a world inherit an error model and a line."""
    path, city = world.network.weights, "city (SHA-256 abc)"
    card = replace(read_card(path), error=replace(MODEL, scores={"inherited_from": city}))
    card = replace(card, accuracy=replace(LINE, inherited_from=city))
    target = world.out.parent / "heirs.safetensors"
    save_with_card(path, target, card)
    return replace(world, network=replace(world.network, weights=target))


@pytest.mark.usefixtures("in_few_steps")
def test_a_run_names_once_inherited_parts_of_its_weights(heirs, tmp_path, caplog):
    caplog.set_level(NOTICE)
    world, both = heirs, "error model and estimated accuracy of city (SHA-256 abc)"
    predict_scans(world.data, world.out, settings=world.network, extras=(ERROR,))
    assert [text for text in caplog.messages if "city" in text] == [
        f"{both}; not fitted to these weights: run `salsanext tune error`"
    ]
    assert (np.load(world.result(ERROR))[~np.isnan(np.load(world.result(ERROR)))] <= 1).all()
    assert json.loads((world.out / "predict.json").read_text())["settings"]["inherited"] == both
    facts = dict(run_of(world.out).facts())
    assert facts["Inherited"] == f"{both}, not fitted to these weights"
    assert run_of(world.out).expected_accuracy() is None
    described = describe_weights(world.network.weights).to_dict()
    assert described["error"] == {"inherited_from": "city (SHA-256 abc)"}
    # A fitted model is no longer inherited; the line still is.
    tuned = tmp_path / "tuned.safetensors"
    world.tune("error", tuned)
    assert read_card(tuned).inherited() == "estimated accuracy of city (SHA-256 abc)"
    caplog.clear()
    settings = replace(world.network, weights=tuned)
    predict_scans(world.data, tmp_path / "tuned", settings=settings, extras=(ERROR,))
    assert [text for text in caplog.messages if "city" in text] == [
        "estimated accuracy of city (SHA-256 abc); not fitted to these weights"
    ]


def test_weights_with_nothing_inherited_have_no_notice(world, caplog):
    caplog.set_level(NOTICE)
    predict_scans(world.data, world.out, settings=world.network)
    assert "fitted" not in caplog.text
    settings = json.loads((world.out / "predict.json").read_text())["settings"]
    assert {"inherited", "weights_version"}.isdisjoint(settings)
    assert "Inherited" not in dict(run_of(world.out).facts())
