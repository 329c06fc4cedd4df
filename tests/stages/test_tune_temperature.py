# SPDX-License-Identifier: MIT
from dataclasses import replace

import numpy as np
import pytest
import torch
from safetensors.torch import load_file
from scans import write_sequence, write_weights

from salsanext_cli.classes import label_space
from salsanext_cli.errors import LabelError, NoInputError, OutputError, TrainingError, WeightsError
from salsanext_cli.formats import read_scan
from salsanext_cli.formats.kitti import read_labels
from salsanext_cli.geometry.projection import project
from salsanext_cli.inference.network import load_network
from salsanext_cli.inference.settings import NetworkSettings
from salsanext_cli.network.weights import read_card, read_weights, save_weights
from salsanext_cli.stages.predict import predict_scans
from salsanext_cli.stages.tune_temperature import tune_temperature
from salsanext_cli.storage.point_files import write_labels
from salsanext_cli.storage.selection import ScanSelection
from salsanext_cli.training.tuning.temperature import negative_log_likelihood

SPACE = label_space()


@pytest.fixture
def drawn(world):
    """Draw the labels of every scan from the network's own softmax at the temperature 2."""
    network, random = load_network(world.network.weights, "cpu"), np.random.default_rng(0)
    for path in sorted(world.data.rglob("*.bin")):
        image = project(read_scan(path), network.sensor)
        logits = network.logits(image).reshape(20, -1)[:, image.pixel_of_point] / 2
        raw = SPACE.to_raw((logits + random.gumbel(size=logits.shape)).argmax(axis=0))
        write_labels(path.parent.parent / "labels" / f"{path.stem}.label", raw)
    return world


def go(world, target, **changes):
    given = {"network": world.network, **changes}
    return tune_temperature(world.data, target, **given)


@pytest.fixture
def target(tmp_path):
    return tmp_path / "tuned.safetensors"


def points_of(world, sequence, stems):
    """Logits and truth of every point that counts, one after another."""
    network = load_network(world.network.weights, "cpu")
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
    assert tuned.after.temperature == pytest.approx(2, rel=0.1)
    assert read_card(target).temperature == tuned.after.temperature
    assert tuned.before.temperature == 1
    assert tuned.after.nll < tuned.before.nll
    assert tuned.after.ece < tuned.before.ece
    logits, truth = points_of(drawn, "08", ["000000", "000001"])
    assert (tuned.scans, tuned.points) == (2, len(truth))
    for found in (tuned.before, tuned.after):
        expected = negative_log_likelihood(logits, truth, found.temperature)
        assert found.nll == pytest.approx(expected, rel=1e-9)
    around = [tuned.after.temperature * factor for factor in (0.99, 1.01)]
    assert all(negative_log_likelihood(logits, truth, t) > tuned.after.nll for t in around)


@pytest.mark.parametrize("half", [False, True])
def test_the_tensors_stay_bit_for_bit_and_as_small(drawn, target, tmp_path, half):
    source = tmp_path / "source.safetensors"
    save_weights(source, *read_weights(drawn.network.weights), half=half)
    go(drawn, target, network=NetworkSettings(source, "cpu"))
    old, new = load_file(source), load_file(target)
    assert {name: t.dtype for name, t in old.items()} == {name: t.dtype for name, t in new.items()}
    assert all(torch.equal(tensor, new[name]) for name, tensor in old.items())
    assert abs(target.stat().st_size - source.stat().st_size) < 64
    card = replace(read_card(target), temperature=1.0)
    assert card.to_metadata() == read_card(source).to_metadata()


def test_a_sample_of_the_points_is_enough_and_always_the_same(drawn, target):
    whole = go(drawn, target)
    some = go(drawn, target, numbers=2 * 700 * 20, overwrite=True)
    first = target.read_bytes()
    again = go(drawn, target, numbers=2 * 700 * 20, overwrite=True)
    assert some == again
    assert first == target.read_bytes()
    assert some.points == 1400 < whole.points
    assert some.after.temperature == pytest.approx(whole.after.temperature, rel=0.1)
    assert some.after.temperature != whole.after.temperature


def test_what_was_tuned_can_be_tuned_again_in_place(drawn, target):
    first = go(drawn, target)
    network = NetworkSettings(target, "cpu")
    again = go(drawn, target, network=network, overwrite=True)
    assert again.before == first.after
    assert again.after.temperature == pytest.approx(first.after.temperature, rel=1e-9)


def test_predict_uses_it_and_keeps_the_labels(drawn, target, tmp_path):
    temperature = go(drawn, target).after.temperature
    before, after = tmp_path / "before", tmp_path / "after"
    predict_scans(drawn.data, before, network=drawn.network, extras=("probabilities",))
    network = NetworkSettings(target, "cpu")
    predict_scans(drawn.data, after, network=network, extras=("probabilities",))
    name = "sequences/08/probabilities/000000.npy"
    powers = np.load(before / name).astype(np.float64) ** (1 / temperature)
    expected = powers / powers.sum(axis=1, keepdims=True)
    np.testing.assert_allclose(np.load(after / name), expected, atol=5e-3)
    name = "sequences/08/predictions/000000.label"
    assert (before / name).read_bytes() == (after / name).read_bytes()


def test_progress_and_which_scans(drawn, target):
    write_sequence(drawn.data / "sequences/08", [f"{i:06d}" for i in range(2, 5)], seed=2)
    seen = []
    selection = ScanSelection(sequences=("08",), limit=3)
    tuned = go(drawn, target, selection=selection, progress=lambda *args: seen.append(args))
    assert tuned.scans == 3
    assert seen == [(1, 3), (2, 3), (3, 3)]


def relabel(world, raw, sequence="08"):
    for path in (world.data / "sequences" / sequence / "labels").iterdir():
        write_labels(path, np.full(1500, raw, np.uint32))


def test_data_that_cannot_be_learnt_from(world, target):
    with pytest.raises(NoInputError, match="no scans of split test"):
        go(world, target, selection=ScanSelection(split="test"))
    relabel(world, 0)
    with pytest.raises(LabelError, match="no point is of a class that counts"):
        go(world, target)
    relabel(world, 1234)
    with pytest.raises(LabelError, match=r"unknown label ids 1234"):
        go(world, target)
    (world.data / "sequences/08/labels/000001.label").unlink()
    with pytest.raises(LabelError, match=r"000001\.label · no such file"):
        go(world, target)
    assert not target.exists()


def test_labels_of_other_classes(world, target, tmp_path):
    small = {"labels": {0: "no", 10: "yes"}, "learning_map": {0: 0, 10: 1}}
    space = type(SPACE).from_dict(small | {"learning_map_inv": {0: 0, 1: 10}, "name": "two"})
    network = NetworkSettings(write_weights(tmp_path / "two.safetensors", space=space), "cpu")
    (world.data / "labels.yaml").write_text(
        "labels: {0: none, 10: car, 40: road}\nlearning_map: {0: 0, 10: 1, 40: 2}\n"
        "learning_map_inv: {0: 0, 1: 10, 2: 40}\nsplit: {valid: ['08']}\n"
    )
    with pytest.raises(LabelError, match="labels in the classes of"):
        go(world, target, network=network)


def constant(world, tmp_path, bias):
    """Return a network that answers the same everywhere."""
    module, card = read_weights(world.network.weights)
    with torch.no_grad():
        module.logits.weight.zero_()
        module.logits.bias.copy_(torch.tensor(bias))
    path = tmp_path / "constant.safetensors"
    save_weights(path, module, card)
    return NetworkSettings(path, "cpu")


def test_a_network_that_is_always_or_never_right_has_no_best_temperature(world, target, tmp_path):
    relabel(world, 10)
    right = constant(world, tmp_path, [0.0, 1.0] + [0.0] * 18)
    with pytest.raises(TrainingError, match=r"each of \d+ points is right"):
        go(world, target, network=right)
    wrong = constant(world, tmp_path, [1.0, 0.0] + [0.0] * 18)
    with pytest.raises(TrainingError, match="whose classes the network does not know"):
        go(world, target, network=wrong)
    assert not target.exists()


def test_logits_that_are_not_finite(world, target, tmp_path):
    module, card = read_weights(world.network.weights)
    with torch.no_grad():
        module.logits.weight.fill_(3e38)
    save_weights(tmp_path / "huge.safetensors", module, card)
    with pytest.raises(WeightsError, match="logits are not finite"):
        go(world, target, network=NetworkSettings(tmp_path / "huge.safetensors", "cpu"))


def test_a_target_that_cannot_be_written_is_noticed_before_the_work(world, target, tmp_path):
    seen = []
    with pytest.raises(OutputError, match=r"suffix \.pt"):
        go(world, tmp_path / "w.pt", progress=seen.append)
    target.write_bytes(b"precious")
    with pytest.raises(OutputError, match="exists"):
        go(world, target, progress=seen.append)
    assert target.read_bytes() == b"precious"
    with pytest.raises(OutputError, match="cannot be written"):
        go(world, target / "w.safetensors", progress=seen.append)
    (tmp_path / "folder.safetensors").mkdir()
    with pytest.raises(OutputError, match="is a folder"):
        go(world, tmp_path / "folder.safetensors", overwrite=True, progress=seen.append)
    assert seen == []
