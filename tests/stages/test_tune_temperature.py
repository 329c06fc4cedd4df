# SPDX-License-Identifier: MIT
import numpy as np
import pytest
import torch

from salsanext_cli import label_space, project, read_labels, read_scan, write_labels
from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.errors import TrainingError, WeightsError
from salsanext_cli.network.card import read_card
from salsanext_cli.network.weights import read_weights, save_weights
from salsanext_cli.stages.predict import predict_scans
from salsanext_cli.stages.tune import tune
from salsanext_cli.training.tuning.temperature import negative_log_likelihood

SPACE = label_space()


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


def go(world, target, **changes):
    given = {"settings": world.network, **changes}
    return tune("temperature", world.data, target, **given)


def points_of(world, sequence, stems):
    """Logits and truth of every point that counts, one after another."""
    network = world.network.load()
    logits, truth = [], []
    for stem in stems:
        path = world.scan(sequence, stem)
        image = project(read_scan(path), network.sensor)
        labels = SPACE.to_train(read_labels(path.parent.parent / "labels" / f"{stem}.label"))
        of_pixels = network.logits(image)
        for point, (pixel, label) in enumerate(zip(image.pixel_of_point, labels, strict=True)):
            if label != 0 and pixel >= 0:
                row, column = divmod(int(image.pixel_of_point[point]), image.width)
                logits.append(of_pixels[:, row, column])
                truth.append(int(label))
    return torch.from_numpy(np.array(logits)), torch.tensor(truth)


def test_the_temperature_of_the_labels_is_found_and_stored(drawn, target):
    before = {path.name for path in target.parent.iterdir()}
    tuned = go(drawn, target)
    assert {path.name for path in target.parent.iterdir()} == before | {target.name}
    assert tuned["after"]["temperature"] == pytest.approx(2, rel=0.1)
    assert read_card(target).temperature == tuned["after"]["temperature"]
    assert tuned["before"]["temperature"] == 1
    assert tuned["after"]["nll"] < tuned["before"]["nll"]
    assert tuned["after"]["ece"] < tuned["before"]["ece"]
    logits, truth = points_of(drawn, "08", ["000000", "000001"])
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


def test_predict_uses_it_and_keeps_the_labels(drawn, target, tmp_path):
    temperature = go(drawn, target)["after"]["temperature"]
    before, after = tmp_path / "before", tmp_path / "after"
    predict_scans(drawn.data, before, settings=drawn.network, extras=("probabilities",))
    network = NetworkSettings(target, "cpu", engine="torch")
    predict_scans(drawn.data, after, settings=network, extras=("probabilities",))
    name = "sequences/08/probabilities/000000.npy"
    powers = np.load(before / name).astype(np.float64) ** (1 / temperature)
    expected = powers / powers.sum(axis=1, keepdims=True)
    np.testing.assert_allclose(np.load(after / name), expected, atol=5e-3)
    name = "sequences/08/predictions/000000.label"
    assert (before / name).read_bytes() == (after / name).read_bytes()


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
