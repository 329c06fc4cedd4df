# SPDX-License-Identifier: MIT
"""Checkpoint and log of a training."""

import csv
import struct
from pathlib import Path

import pytest
import torch
from fuzzing.limits import bounded
from scans import refused
from tiny_network import TinyNetwork

from salsanext_cli.core.errors import TrainingError
from salsanext_cli.training.checkpoint import TrainingState, load_checkpoint, save_checkpoint
from salsanext_cli.training.learner import Learner
from salsanext_cli.training.recipe import Recipe
from salsanext_cli.training.run_folder import write_log

NAME = "c.safetensors"


def learner(classes: int = 3, **changes: object) -> Learner:
    recipe = Recipe(epochs=9, optimiser="adamw", average=0.9).with_changes(**changes)
    return Learner(TinyNetwork(classes), recipe, torch.ones(classes), torch.device("cpu"))


def trained(**changes: object) -> Learner:
    learning = learner(**changes)
    images = torch.randn(2, 5, 16, 16)
    learning.step(images, torch.ones(2, 16, 16, dtype=torch.uint8), 0, 1)
    return learning


def refuse(path: Path, learning: Learner) -> None:
    """Fail unless a file is refused at once and without taking memory."""
    with bounded(0), refused(TrainingError, path) as caught:
        load_checkpoint(path, learning)
    assert "\n" not in caught.value.headline


@pytest.mark.parametrize("changes", [{}, {"average": 0.0}, {"optimiser": "sgd"}])
@pytest.mark.parametrize("steps", [0, 1])
def test_round_trip(tmp_path: Path, changes: dict[str, object], steps: int) -> None:
    rows = [{"epoch": 1, "loss": 2.5}, {"epoch": 2, "loss": 0.1, "miou": 0.25}]
    learning, state = learner(**changes), TrainingState()
    if steps:
        learning, state = (
            trained(**changes),
            TrainingState(epoch=2, best=0.5, rows=rows, losses=[0.1, 1 / 3], seconds=3.5),
        )
    save_checkpoint(tmp_path / NAME, learning, state)
    first = (tmp_path / NAME).read_bytes()
    save_checkpoint(tmp_path / NAME, learning, state)
    assert (tmp_path / NAME).read_bytes() == first
    other = learner(**changes)
    assert load_checkpoint(tmp_path / NAME, other) == state
    for mine, theirs in ((learning.module, other.module), (learning.average, other.average)):
        for a, b in zip(mine.state_dict().values(), theirs.state_dict().values(), strict=True):
            assert torch.equal(a, b)
    saved, loaded = (each.optimiser.state_dict()["state"] for each in (learning, other))
    assert saved.keys() == loaded.keys()
    for key, values in saved.items():
        assert values.keys() == loaded[key].keys()
        assert all(torch.equal(value, loaded[key][name]) for name, value in values.items())


def test_the_scale_of_float16_is_restored(tmp_path: Path) -> None:
    learning = learner(precision="float16")
    learning.scaler.scale(torch.zeros(()))  # a scaler has its state from its first use on
    learning.scaler.update(4096.0)
    save_checkpoint(tmp_path / NAME, learning, TrainingState())
    other = learner(precision="float16")
    load_checkpoint(tmp_path / NAME, other)
    assert other.scaler.get_scale() == 4096


def test_damaged_checkpoints_and_those_of_another_training_are_refused(tmp_path: Path) -> None:
    path = tmp_path / NAME
    save_checkpoint(path, trained(), TrainingState(epoch=2))
    refuse(path, learner(classes=4))
    whole = path.read_bytes()
    start = 8 + struct.unpack("<Q", whole[:8])[0]
    for share in (0.0, 0.5, 0.9):
        flipped = bytearray(whole)
        flipped[start + int(share * (len(whole) - start))] ^= 4
        path.write_bytes(flipped)
        refuse(path, learner())
    for cut in (0, 100, -1):
        path.write_bytes(whole[:cut])
        refuse(path, learner())


def test_pickles_are_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / NAME).write_bytes(b"cos\nmkdir\n(S'executed'\ntR.")
    refuse(tmp_path / NAME, learner())
    assert [path.name for path in tmp_path.iterdir()] == [NAME]


ROWS = [
    {"epoch": 1, "loss": 3.25},
    {"epoch": 2, "loss": 2.5, "miou": 0.25, "iou_car": float("nan"), "iou_road": 0.5},
]


def test_log_has_a_line_per_epoch_and_nothing_where_nothing_was_measured(tmp_path: Path) -> None:
    write_log(tmp_path / "log.csv", ROWS)
    with (tmp_path / "log.csv").open(newline="") as file:
        first, second = csv.DictReader(file)
    empty = {"miou": "", "iou_car": "", "iou_road": ""}
    assert first == {"epoch": "1", "loss": "3.25", **empty}
    assert second == {"epoch": "2", "loss": "2.5", **empty, "miou": "0.25", "iou_road": "0.5"}
