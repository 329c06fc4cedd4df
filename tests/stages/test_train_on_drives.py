# SPDX-License-Identifier: MIT
"""Training on the fused labels of a drive: what teaches, what is held out, what is refused."""

import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from scans import SMALL, make_scan
from tiny_network import TinyNetwork

from salsanext_cli import Scan, label_space, read_labels
from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.errors import NoInputError, TrainingError, UsageError
from salsanext_cli.formats.kitti import write_bin
from salsanext_cli.fusion.poses import encode_poses
from salsanext_cli.fusion.window import movable_classes
from salsanext_cli.network.card import WeightsCard, scan_digest
from salsanext_cli.network.weights import read_weights, save_weights
from salsanext_cli.stages import train as stage
from salsanext_cli.stages.fuse import fuse_results
from salsanext_cli.stages.predict import predict_scans
from salsanext_cli.stages.train import train
from salsanext_cli.training.data.fused import agreement, fused_drives
from salsanext_cli.training.data.sources import read_labelled
from salsanext_cli.training.recipe import recipe

SPACE = label_space()
DRIVE = recipe("drive").with_changes(
    streets=0, samples_per_epoch=4, batch=2, crop_width=32, learning_rate=1e-9, disagreement=0.9
)

pytestmark = pytest.mark.usefixtures("tiny_training")


@pytest.fixture
def start(tiny_training: None, tmp_path: Path) -> Path:
    """Write weights to start from, with a temperature."""
    torch.manual_seed(1)
    card = WeightsCard({"name": "salsanext", "class_count": 20}, SPACE, SMALL, temperature=1.5)
    save_weights(tmp_path / "start.safetensors", TinyNetwork(), card)
    return tmp_path / "start.safetensors"


@pytest.fixture
def fused(start: Path, tmp_path: Path) -> Path:
    """Fuse ten scans of one place, each with its own noise."""
    folder, scan = tmp_path / "data/sequences/08", make_scan()
    for number in range(10):
        noise = np.random.default_rng(number).normal(0, 0.02, scan.points.shape)
        noisy = Scan((scan.points + noise).astype(np.float32), scan.intensity)
        write_bin(folder / f"velodyne/{number:06}.bin", noisy)
    (folder / "poses.txt").write_bytes(encode_poses(np.tile(np.eye(4), (10, 1, 1))))
    network = NetworkSettings(start, "cpu", engine="torch")
    predict_scans(folder, tmp_path / "out", network=network, extras=("votes",))
    fuse_results(tmp_path / "out")
    return tmp_path / "out/fused"


def test_labels_teach_where_enough_views_agree(fused):
    _, scans, drives = fused_drives(fused, 0.7)
    assert [f.stem for f in drives["08"]] == [f"{n:06}" for n in range(10)]
    assert scans == drives["08"][:5]
    folder, movable, taught = fused / "sequences/08", movable_classes(SPACE), 0
    views_path = folder / "views/000002.npy"
    np.save(views_path, np.resize(np.arange(1, 5, dtype=np.uint16), 1500))
    _, targets = read_labelled(scans[2], SPACE, SMALL)
    labels = SPACE.to_train(read_labels(folder / "predictions/000002.label"))
    against = np.load(folder / "uncertainty/disagreement/000002.npy")
    views = np.load(views_path)
    for i in range(1500):
        enough = views[i] >= (2 if movable[labels[i]] else 3)
        expected = labels[i] if against[i] <= 0.7 and enough else 0
        assert targets[i] == expected
        taught += expected > 0
    assert 0 < taught < 1500


def test_weights_that_agree_no_less_are_kept(fused, start, tmp_path, monkeypatch):
    found = iter((0.5, 0.52))
    monkeypatch.setattr(stage, "agreement", lambda *_: next(found))
    done = train(fused, tmp_path / "run", recipe=DRIVE, weights=start, device="cpu")
    _, card = read_weights(done.best)
    assert done.best.read_bytes() == done.last.read_bytes()
    assert card.temperature == 1.5
    _, _, drives = fused_drives(fused, 0.9)
    digests = [scan_digest(read_labelled(f, SPACE, SMALL)[0]) for f in drives["08"]]
    assert card.trained_on == {*digests[:5]}


def test_weights_that_agree_less_are_not(fused, start, tmp_path, monkeypatch):
    run = tmp_path / "run"
    for after in (0.4, 0.519, 0.4):
        found = iter((0.5, after))
        monkeypatch.setattr(stage, "agreement", lambda *_, found=found: next(found))
        with pytest.raises(
            TrainingError,
            match=r"last.safetensors .* leaves .* before 50.0 % .* at least 2 points more",
        ):
            train(fused, run, recipe=DRIVE, weights=start, device="cpu")
        assert not (run / "best.safetensors").exists()


def test_agreement_is_that_of_the_second_half_alone(fused, start, tmp_path):
    """What `predict` and `fuse` say of these scans is the same."""
    module, card = read_weights(start)
    network = stage.network_of_module(module, card, "cpu")
    data, held = tmp_path / "data/sequences/08", tmp_path / "held/08"
    (held / "velodyne").mkdir(parents=True)
    for number in range(5, 10):
        shutil.copy(data / f"velodyne/{number:06}.bin", held / "velodyne")
    (held / "poses.txt").write_bytes(encode_poses(np.tile(np.eye(4), (5, 1, 1))))
    settings = NetworkSettings(start, "cpu", engine="torch")
    predict_scans(held, tmp_path / "of-held", network=settings, extras=("probabilities",))
    fuse_results(tmp_path / "of-held")
    same, total = 0, 0
    for path in sorted((tmp_path / "of-held/fused").rglob("*.label")):
        single = read_labels(tmp_path / f"of-held/sequences/08/predictions/{path.name}")
        views = np.load(path.parents[1] / f"views/{path.stem}.npy")
        seen = (views > 1) & (single > 0)
        same += np.count_nonzero((read_labels(path) == single) & seen)
        total += np.count_nonzero(seen)
    _, _, drives = fused_drives(fused, 0.5)
    assert agreement(network, drives, {}) == pytest.approx(same / total, abs=0.003)
    assert 0.1 < same / total < 0.99


def test_other_folders_are_refused(fused, start, tmp_path):
    for folder in (fused.parent, tmp_path / "data"):
        with pytest.raises(NoInputError, match=r"no fused labels .* --fuse|holds no results"):
            train(folder, tmp_path / "run", recipe=DRIVE, weights=start, device="cpu")
    (fused / "sequences/08/predictions/000000.label").unlink()
    with pytest.raises(NoInputError, match="9 scans of sequence 08 · expected at least 10"):
        train(fused, tmp_path / "run", recipe=DRIVE, weights=start, device="cpu")
    assert not (tmp_path / "run").exists()


def test_weights_of_other_classes_or_none_are_refused(fused, start, tmp_path):
    other = tmp_path / "other.safetensors"
    card = WeightsCard({"name": "salsanext", "class_count": 8}, label_space("coarse"), SMALL)
    save_weights(other, TinyNetwork(8), card)
    for weights, recipe_ in ((other, DRIVE), (None, DRIVE.with_changes(initial="random"))):
        with pytest.raises(UsageError, match="expected weights of the same classes"):
            train(fused, tmp_path / "run", recipe=recipe_, weights=weights, device="cpu")
