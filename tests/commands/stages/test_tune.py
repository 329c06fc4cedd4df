# SPDX-License-Identifier: MIT
"""Stages of tuning: what they share, temperature, dropout."""

import logging
import math
import shutil
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from calls import calls_of
from command_line import python
from safetensors.torch import load_file
from scans import SMALL, refused, salsanext_of, write_sequence, write_weights
from shallow_network import SHALLOW

from salsanext_cli import (
    label_space,
    load_network,
    project,
    read_labels,
    read_scan,
    sample,
    write_labels,
)
from salsanext_cli.commands.stages import tune
from salsanext_cli.core.errors import (
    LabelError,
    NoInputError,
    OutputError,
    TrainingError,
    UsageError,
    WeightsError,
)
from salsanext_cli.core.network.card import scan_digest
from salsanext_cli.core.network.dropout import dropouts
from salsanext_cli.core.network.registry import ARCHITECTURES
from salsanext_cli.core.network.salsanext import SalsaNext
from salsanext_cli.core.uncertainty.aleatoric import aleatoric
from salsanext_cli.core.uncertainty.monte_carlo import scan_seed
from salsanext_cli.io.weights.card_file import read_card
from salsanext_cli.io.weights.weights import read_weights, save_weights, save_with_card
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.scans.scan_selection import ScanSelection
from salsanext_cli.training.tuning.dropout_rate import MIN_VARIANCE
from salsanext_cli.training.tuning.temperature import best_temperature, negative_log_likelihood

SPACE = label_space()
LABELS = "sequences/08/labels"
FEW = {"samples": 3}
VALID = ScanSelection("valid")


@pytest.fixture
def world(world):
    """Return the world with the sensor of its scans: nothing here depends on a fit."""
    return world.unfitted()


@pytest.fixture(autouse=True)
def few_rates(monkeypatch):
    """Let `tune dropout` try three rates."""
    rates = np.geomspace(0.05, 0.3, 3).tolist()
    monkeypatch.setattr("salsanext_cli.training.tuning.dropout_rate.RATES", rates)


def go(world, target, part="temperature", **changes):
    given = {"settings": world.network, **(FEW if part == "dropout" else {}), **changes}
    stage = getattr(tune, f"tune_{part}")
    return stage(world.data, target, **given).to_dict()


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


@pytest.mark.usefixtures("one_step_fits")
@pytest.mark.parametrize("part", ["temperature", "error", "dropout", "risk"])
def test_scans_of_training_and_copies_are_skipped(drawn, target, tmp_path, caplog, part):
    """Of three scans, one was trained on and one is its copy."""
    known = tmp_path / "known.safetensors"
    shutil.copy(drawn.scan("08", "000000"), drawn.scan("00", "000000"))
    labels = drawn.data / "sequences/08/labels/000000.label"
    shutil.copy(labels, drawn.data / "sequences/00/labels/000000.label")
    digests = [scan_digest(read_scan(drawn.scan("08", f"00000{i}"))) for i in (0, 1)]
    card = read_card(drawn.network.weights)
    save_with_card(drawn.network.weights, known, replace(card, trained_on=frozenset(digests[:1])))
    network, every = replace(drawn.network, weights=known), ScanSelection(sequences=("00", "08"))
    numbers = {"at_most": 0.9} if part == "risk" else {}
    tuned = go(drawn, target, part, settings=network, selection=every, **numbers)
    assert (tuned["scans"], tuned["skipped"]) == (1, 2)
    assert "2 scans skipped: the weights were trained on them, or they are copies" in caplog.text
    save_with_card(drawn.network.weights, known, replace(card, trained_on=frozenset(digests)))
    with pytest.raises(TrainingError):
        go(drawn, target, part, settings=network, selection=every, overwrite=True, **numbers)


def test_a_limit_counts_the_scans_that_are_not_skipped(world, target, tmp_path, caplog):
    """The first and the last of five scans, which a limit of two takes, are of the training."""
    write_sequence(world.data / "sequences/08", [f"{i:06d}" for i in range(2, 5)], seed=2)
    digests = {scan_digest(read_scan(world.scan("08", f"00000{i}"))) for i in (0, 4)}
    known = tmp_path / "known.safetensors"
    card = replace(read_card(world.network.weights), trained_on=frozenset(digests))
    save_with_card(world.network.weights, known, card)
    options = {"settings": replace(world.network, weights=known)}
    tuned = go(world, target, selection=ScanSelection("valid", limit=2), **options)
    assert (tuned["scans"], tuned["skipped"]) == (2, 2)
    more = ScanSelection("valid", limit=4)
    tuned = go(world, target, selection=more, overwrite=True, **options)
    assert (tuned["scans"], tuned["skipped"]) == (3, 2)


def test_what_can_be_seen_at_once_is_refused_before_the_network_is_loaded(world, target, tmp_path):
    existing = tmp_path / "existing.safetensors"
    existing.write_bytes(b"precious")
    with calls_of(NetworkSettings.load) as loadings:
        for part in ("temperature", "error", "dropout", "risk"):
            numbers = {"at_most": 0.05} if part == "risk" else {}
            refused(OutputError, existing, go, world, existing, part, **numbers)
            stage = getattr(tune, f"tune_{part}")
            with pytest.raises(NoInputError):
                stage(tmp_path / "nowhere", target, settings=world.network, **numbers)
        refused(TrainingError, world.data, go, world, target, "risk", at_most=0.05)
        refused(UsageError, "at_most", go, world, target, "risk", at_most=5)
        shutil.rmtree(world.data / LABELS)
        label = world.data / LABELS / "000000.label"
        refused(LabelError, label, go, world, target, selection=VALID)
    assert not loadings


def test_refusing_needs_no_torch(tmp_path):
    """Importing it takes longer than all other packages together."""
    nowhere = str(tmp_path / "nowhere")
    commands = [["tune", "error", nowhere, str(tmp_path / "w.safetensors")], ["eval", nowhere]]
    ended = python(
        f"""
import sys
from salsanext_cli.commands.line.app import app
for command in {commands!r}:
    try:
        app(command)
    except SystemExit as end:
        print(end.code, "torch" in sys.modules, "openvino" in sys.modules)
"""
    )
    assert ended.stdout == 2 * "1 False False\n", ended.stderr


def test_sequences_of_no_split_are_used_and_those_of_training_named(world, target, caplog):
    for name in ("x1", "x2"):
        write_sequence(world.data / "sequences" / name, ["000000"], seed=ord(name[1]))
    shutil.rmtree(world.data / "sequences/x2/labels")
    assert go(world, target)["scans"] == 3
    assert "3 of 5 scans used; not used: 00 (split train), x2 (no split)" in caplog.text
    caplog.clear()
    valid = ScanSelection(split="valid")
    assert go(world, target, selection=valid, overwrite=True)["scans"] == 2
    assert "2 of 5 scans used; not used: 00 (split train), x1, x2 (no split)" in caplog.text
    for name in ("x1", "x2", "08"):
        shutil.rmtree(world.data / "sequences" / name)
    with pytest.raises(NoInputError):
        go(world, target, overwrite=True)


def test_a_file_that_was_written_meanwhile_stays(world, target):
    with pytest.raises(OutputError):
        go(world, target, progress=lambda *_: target.write_bytes(b"of another run"))
    assert target.read_bytes() == b"of another run"


def test_an_unusable_target_is_refused_before_the_work(world, target, tmp_path):
    target.write_bytes(b"precious")
    for place in (tmp_path / "w.pt", target, target / "w.safetensors"):
        with pytest.raises(OutputError):
            go(world, place, progress=pytest.fail)
    assert target.read_bytes() == b"precious"


@pytest.mark.parametrize(
    ("raw", "subject"),
    [(0, ""), (1234, LABELS + "/000000.label"), (None, LABELS + "/000000.label")],
)
def test_labels_that_cannot_be_learnt_from(world, target, raw, subject):
    for path in (world.data / LABELS).iterdir():
        if raw is None:
            path.unlink()
        else:
            write_labels(path, np.full(1500, raw, np.uint32))
    refused(LabelError, world.data / subject, go, world, target)
    assert not target.exists()


def test_labels_of_other_classes(world, target):
    (world.data / "labels.yaml").write_text(
        "labels: {0: none, 10: car, 40: road}\nlearning_map: {0: 0, 10: 1, 40: 2}\n"
        "learning_map_inv: {0: 0, 1: 10, 2: 40}\nsplit: {valid: ['08']}\n"
    )
    refused(LabelError, world.data, go, world, target)


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


def test_the_temperature_of_the_labels_is_estimated_and_stored(drawn, target):
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
    scans = []
    for _, image, points in labelled_points(drawn):
        of_pixels = drawn.network.load().logits(image)
        logits = np.array([of_pixels[:, row, column] for row, column, _ in points])
        scans.append((torch.from_numpy(logits), torch.tensor([label for *_, label in points])))
    every = [torch.cat(parts) for parts in zip(*scans, strict=True)]
    assert (tuned["scans"], tuned["points"], tuned["folds"]) == (2, len(every[1]), 2)
    expected = negative_log_likelihood(*every, 1.0)
    assert tuned["before"]["nll"] == pytest.approx(expected, rel=1e-9)
    best, *around = (tuned["after"]["temperature"] * factor for factor in (1, 0.99, 1.01))
    least = negative_log_likelihood(*every, best)
    assert all(negative_log_likelihood(*every, t) > least for t in around)
    # Each scan is judged at the temperature of the other one.
    losses = [
        negative_log_likelihood(*scan, best_temperature(*other)) * len(scan[1])
        for scan, other in (scans, scans[::-1])
    ]
    assert tuned["after"]["nll"] == pytest.approx(sum(losses) / len(every[1]), rel=1e-6)


def test_the_temperature_stays_if_another_is_worse(drawn, target, tmp_path, monkeypatch):
    tempered = tmp_path / "tempered.safetensors"
    card = replace(read_card(drawn.network.weights), temperature=1.4)
    save_with_card(drawn.network.weights, tempered, card)
    module = "salsanext_cli.training.tuning.temperature"
    monkeypatch.setattr(f"{module}.best_temperature", lambda *_: 50.0)
    tuned = go(drawn, target, settings=replace(drawn.network, weights=tempered))
    assert tuned["after"]["nll"] > tuned["before"]["nll"]
    assert not tuned["changed"]
    assert target.read_bytes() == tempered.read_bytes()


def test_a_sample_of_the_points_is_enough_and_always_the_same(drawn, target, monkeypatch):
    whole = go(drawn, target)
    monkeypatch.setattr("salsanext_cli.training.tuning.temperature.MAX_LOGITS", 2 * 700 * 20)
    some = go(drawn, target, overwrite=True)
    assert some == go(drawn, target, overwrite=True)
    assert some["points"] == 1400 < whole["points"]
    assert some["after"]["temperature"] == pytest.approx(whole["after"]["temperature"], rel=0.1)
    assert some["after"]["temperature"] != whole["after"]["temperature"]


@pytest.mark.parametrize(
    ("weight", "bias", "error"),
    [(0.0, [0.0, 1.0], TrainingError), (3e38, [0.0, 0.0], WeightsError)],
)
def test_networks_without_a_best_temperature(world, target, tmp_path, weight, bias, error):
    """Their logits are the same everywhere, or not finite."""
    for path in (world.data / LABELS).iterdir():
        write_labels(path, np.full(1500, 10, np.uint32))
    module, card = read_weights(world.network.weights)
    with torch.no_grad():
        module.logits.weight.fill_(weight)
        module.logits.bias.copy_(torch.tensor(bias + [0.0] * 18))
    save_weights(tmp_path / "odd.safetensors", module, card)
    odd = NetworkSettings(tmp_path / "odd.safetensors", "cpu", engine="torch")
    with pytest.raises(error):
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
    write_sequence(world.data / "sequences/08", ["000000", "000001"], count=400, seed=5)
    tuned = go(world, target, "dropout")
    slow = [slow_mean(world, tmp_path / "w.safetensors", rate) for rate in tuned["rates"]]
    np.testing.assert_allclose(tuned["objectives"], slow, rtol=1e-5)
    # The rate of the weights is among them.
    np.testing.assert_allclose(tuned["rates"], [0.05, math.sqrt(0.05 * 0.3), 0.2, 0.3])
    assert tuned["best"] == tuned["rates"][int(np.argmin(slow))]
    assert tuned["changed"]
    assert tuned["before"] == 0.2
    assert tuned["scans"] == 2
    assert read_card(target).architecture["dropout"] == tuned["best"]
    assert {layer.rate for layer in dropouts(read_weights(target)[0])} == {tuned["best"]}


def test_weights_without_dropout_get_the_layers_of_the_paper(world, target, tmp_path):
    weights = tmp_path / "w.safetensors"
    settings = NetworkSettings(weights, "cpu", engine="torch")
    once = {"selection": ScanSelection("valid", limit=1), "settings": settings}
    with salsanext_of(widths=(8,) * 5, decoder_widths=(8,) * 4):
        write_weights(weights, dropout=0.0)
        tuned = go(world, target, "dropout", **once)
        assert tuned["before"] == 0
        assert len(dropouts(read_weights(target)[0])) == 3 + 1 + 3 * 3
        write_weights(weights)
        usual = go(world, target, "dropout", overwrite=True, **once)
    usual["objectives"].pop(usual["rates"].index(0.2))
    assert tuned["objectives"] == usual["objectives"]


@pytest.mark.parametrize(
    ("objectives", "best", "warning"),
    [
        ([1.0, 2.0, 3.0, 4.0] * 2, 0.05, "at an end of the range"),
        ([3.0, 1.0, 2.0, 3.0] * 2, math.sqrt(0.05 * 0.3), ""),
        # The existing rate, 0.2, wins ties, and if the choice of one scan is worse in the other.
        ([3.0, 1.0, 1.0, 3.0] * 2, 0.2, ""),
        ([0.0, 9.0, 1.0, 9.0] + [9.0, 0.0, 1.0, 9.0], 0.2, ""),
    ],
)
def test_the_end_of_the_range_warns(
    world, target, tmp_path, caplog, monkeypatch, objectives, best, warning
):
    monkeypatch.setitem(ARCHITECTURES, "salsanext", partial(SalsaNext, **SHALLOW))
    settings = replace(world.network, weights=write_weights(tmp_path / "shallow.safetensors"))
    values = iter(objectives)
    module = "salsanext_cli.training.tuning.dropout_rate"
    monkeypatch.setattr(f"{module}.objective", lambda *_: next(values))
    with caplog.at_level(logging.WARNING):
        tuned = go(world, target, "dropout", settings=settings, selection=VALID)
    assert tuned["best"] == pytest.approx(best)
    assert warning in caplog.text
    assert bool(caplog.text) == bool(warning)
