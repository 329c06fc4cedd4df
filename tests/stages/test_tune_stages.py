# SPDX-License-Identifier: MIT
"""Stages of tuning: what they share, temperature, dropout."""

import logging
import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from safetensors.torch import load_file
from scans import SMALL, write_sequence, write_weights

from salsanext_cli import (
    label_space,
    load_network,
    project,
    read_labels,
    read_scan,
    sample,
    write_labels,
)
from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.errors import LabelError, OutputError, TrainingError, WeightsError
from salsanext_cli.network.card import read_card
from salsanext_cli.network.dropout import dropouts
from salsanext_cli.network.weights import read_weights, save_weights
from salsanext_cli.options import ScanSelection
from salsanext_cli.stages.tune import tune
from salsanext_cli.training.tuning.dropout_rate import MIN_VARIANCE
from salsanext_cli.training.tuning.temperature import negative_log_likelihood
from salsanext_cli.uncertainty.aleatoric import aleatoric
from salsanext_cli.uncertainty.monte_carlo import scan_seed

SPACE = label_space()
FEW = {"samples": 3, "steps": 3, "lowest": 0.05, "highest": 0.3}


def go(world, target, part="temperature", **changes):
    given = {"settings": world.network, **(FEW if part == "dropout" else {}), **changes}
    return tune(part, world.data, target, **given)


def labelled_points(world):
    """Yield stem, range image, and row, column and train id of every point that counts."""
    for stem in ("000000", "000001"):
        path = world.scan("08", stem)
        image = project(read_scan(path), SMALL)
        labels = SPACE.to_train(read_labels(path.parents[1] / "labels" / f"{stem}.label"))
        counts = (labels != 0) & (image.pixel_of_point >= 0)
        places = np.divmod(image.pixel_of_point[counts], image.width)
        yield stem, image, list(zip(*places, labels[counts].tolist(), strict=True))


def test_tensors_stay_as_they_are_stored(world, target, tmp_path):
    source = tmp_path / "source.safetensors"
    save_weights(source, *read_weights(world.network.weights), half=True)
    go(world, target, settings=NetworkSettings(source, "cpu", engine="torch"))
    old, new = load_file(source), load_file(target)
    assert {name: t.dtype for name, t in old.items()} == {name: t.dtype for name, t in new.items()}
    assert all(torch.equal(new[name], tensor) for name, tensor in old.items())


def test_progress_and_selection(world, target, caplog):
    write_sequence(world.data / "sequences/08", [f"{i:06d}" for i in range(2, 5)], seed=2)
    seen, selection = [], ScanSelection(split="valid", limit=3)
    with caplog.at_level(logging.INFO, "salsanext_cli.training.tuning"):
        tuned = go(world, target, selection=selection, progress=lambda *n: seen.append(n))
    assert tuned["scans"] == 3
    assert seen == [(number, 3) for number in range(1, 4)]
    named = [message[:9] for message in caplog.messages if message.startswith("08/")]
    assert named == [f"08/00000{i}" for i in (0, 2, 4)]


def test_what_cannot_be_written_is_noticed_before_the_work(world, target, tmp_path):
    target.write_bytes(b"precious")
    for place in (tmp_path / "w.pt", target, target / "w.safetensors"):
        with pytest.raises(OutputError):
            go(world, place, progress=pytest.fail)
    assert target.read_bytes() == b"precious"


@pytest.mark.parametrize(
    ("raw", "says"),
    [
        (0, "no point is of a class that counts"),
        (1234, r"unknown label ids 1234"),
        (None, r"00000\d\.label · no such file"),
    ],
)
def test_labels_that_cannot_be_learnt_from(world, target, raw, says):
    for path in (world.data / "sequences/08/labels").iterdir():
        if raw is None:
            path.unlink()
        else:
            write_labels(path, np.full(1500, raw, np.uint32))
    with pytest.raises(LabelError, match=says):
        go(world, target)
    assert not target.exists()


def test_labels_of_other_classes(world, target):
    (world.data / "labels.yaml").write_text(
        "labels: {0: none, 10: car, 40: road}\nlearning_map: {0: 0, 10: 1, 40: 2}\n"
        "learning_map_inv: {0: 0, 1: 10, 2: 40}\nsplit: {valid: ['08']}\n"
    )
    with pytest.raises(LabelError, match="labels in the classes of"):
        go(world, target)


@pytest.fixture
def drawn(world):
    """Draw the labels of every scan from the network's own softmax at the temperature 2."""
    network, random = world.network.load(), np.random.default_rng(0)
    for path in sorted(world.data.rglob("*.bin")):
        image = project(read_scan(path), network.sensor)
        logits = network.logits(image).reshape(20, -1)[:, image.pixel_of_point] / 2
        raw = SPACE.to_raw((logits + random.gumbel(size=logits.shape)).argmax(axis=0))
        write_labels(path.parent.parent / "labels" / f"{path.stem}.label", raw)
    return world


def test_the_temperature_of_the_labels_is_found_and_stored(drawn, target):
    before = {path.name for path in target.parent.iterdir()}
    tuned = go(drawn, target)
    assert {path.name for path in target.parent.iterdir()} == before | {target.name}
    assert tuned["after"]["temperature"] == pytest.approx(2, rel=0.1)
    card = read_card(target)
    assert card.temperature == tuned["after"]["temperature"]
    untuned = read_card(drawn.network.weights).to_metadata()
    assert replace(card, temperature=1.0).to_metadata() == untuned
    assert tuned["before"]["temperature"] == 1
    assert tuned["after"]["nll"] < tuned["before"]["nll"]
    assert tuned["after"]["ece"] < tuned["before"]["ece"]
    logits, truth = [], []
    for _, image, points in labelled_points(drawn):
        of_pixels = drawn.network.load().logits(image)
        logits += [of_pixels[:, row, column] for row, column, _ in points]
        truth += [label for *_, label in points]
    logits, truth = torch.from_numpy(np.array(logits)), torch.tensor(truth)
    assert (tuned["scans"], tuned["points"]) == (2, len(truth))
    for found in (tuned["before"], tuned["after"]):
        expected = negative_log_likelihood(logits, truth, found["temperature"])
        assert found["nll"] == pytest.approx(expected, rel=1e-9)
    around = [tuned["after"]["temperature"] * factor for factor in (0.99, 1.01)]
    assert all(negative_log_likelihood(logits, truth, t) > tuned["after"]["nll"] for t in around)


def test_a_sample_of_the_points_is_enough_and_always_the_same(drawn, target, monkeypatch):
    whole = go(drawn, target)
    monkeypatch.setattr("salsanext_cli.training.tuning.temperature.MAX_LOGITS", 2 * 700 * 20)
    some = go(drawn, target, overwrite=True)
    assert some == go(drawn, target, overwrite=True)
    assert some["points"] == 1400 < whole["points"]
    assert some["after"]["temperature"] == pytest.approx(whole["after"]["temperature"], rel=0.1)
    assert some["after"]["temperature"] != whole["after"]["temperature"]


@pytest.mark.parametrize(
    ("weight", "bias", "error", "says"),
    [
        (0.0, [0.0, 1.0], TrainingError, r"for \d+ points is 0 "),
        (3e38, [0.0, 0.0], WeightsError, "logits are not finite"),
    ],
)
def test_networks_without_a_best_temperature(world, target, tmp_path, weight, bias, error, says):
    """They answer the same everywhere, or nothing that is finite."""
    for path in (world.data / "sequences/08/labels").iterdir():
        write_labels(path, np.full(1500, 10, np.uint32))
    module, card = read_weights(world.network.weights)
    with torch.no_grad():
        module.logits.weight.fill_(weight)
        module.logits.bias.copy_(torch.tensor(bias + [0.0] * 18))
    save_weights(tmp_path / "odd.safetensors", module, card)
    odd = NetworkSettings(tmp_path / "odd.safetensors", "cpu", engine="torch")
    with pytest.raises(error, match=says):
        go(world, target, settings=odd)
    assert not target.exists()


def slow_mean(world, path, rate):
    """Return the objective of one rate by a loop over points, from weights of that rate."""
    network, terms = load_network(write_weights(path, dropout=rate), "cpu", engine="torch"), []
    for stem, image, points in labelled_points(world):
        seed = scan_seed(0, "08", stem)
        sampled = sample(network, image, samples=FEW["samples"], seed=seed)
        variance = sampled.variance.astype(np.float64) + aleatoric(network, image)
        for row, column, label in points:
            s = np.maximum(variance[:, row, column], MIN_VARIANCE)
            error = np.eye(20)[label] - sampled.probabilities[:, row, column]
            terms.append((0.5 * np.log(s) + error**2 / (2 * s)).sum())
    return np.mean(terms)


def test_every_rate_against_a_slow_loop_and_the_least_is_stored(world, target, tmp_path):
    tuned = go(world, target, "dropout")
    slow = [slow_mean(world, tmp_path / "w.safetensors", rate) for rate in tuned["rates"]]
    np.testing.assert_allclose(tuned["objectives"], slow, rtol=1e-5)
    np.testing.assert_allclose(tuned["rates"], [0.05, math.sqrt(0.05 * 0.3), 0.3])
    assert tuned["best"] == tuned["rates"][int(np.argmin(slow))]
    assert tuned["before"] == 0.2
    assert tuned["scans"] == 2
    assert read_card(target).architecture["dropout"] == tuned["best"]
    assert {layer.rate for layer in dropouts(read_weights(target)[0])} == {tuned["best"]}


def test_a_network_that_was_trained_without_dropout_gets_it_where_the_paper_has_it(
    world, target, tmp_path
):
    certain = write_weights(tmp_path / "certain.safetensors", dropout=0.0)
    settings = NetworkSettings(certain, "cpu", engine="torch")
    tuned = go(world, target, "dropout", settings=settings)
    assert tuned["before"] == 0
    assert len(dropouts(read_weights(target)[0])) == 3 + 1 + 3 * 3
    assert tuned["objectives"] == go(world, target, "dropout", overwrite=True)["objectives"]


@pytest.mark.parametrize(
    ("objectives", "best", "says"),
    [
        ([1.0, 2.0, 3.0], 0.05, "best rate, 0.05, is the last of the range: move --lowest"),
        ([3.0, 1.0, 2.0], math.sqrt(0.05 * 0.3), ""),
    ],
)
def test_the_end_of_the_range_is_named(world, target, caplog, monkeypatch, objectives, best, says):
    values = iter(objectives * 2)
    module = "salsanext_cli.training.tuning.dropout_rate"
    monkeypatch.setattr(f"{module}.objective", lambda *_: next(values))
    with caplog.at_level(logging.WARNING):
        assert go(world, target, "dropout")["best"] == pytest.approx(best)
    assert says in caplog.text
    assert bool(caplog.text) == bool(says)
