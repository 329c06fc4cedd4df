# SPDX-License-Identifier: MIT
"""Checkpoint and log of a training."""

import csv
import struct
import sys
from pathlib import Path
from unittest.mock import MagicMock

import numpy as np
import pytest
import torch
from fuzzing.limits import bounded
from matplotlib.image import imread
from tiny_network import TinyNetwork

from salsanext_cli.errors import TrainingError
from salsanext_cli.training import log
from salsanext_cli.training.checkpoint import TrainingState, load_checkpoint, save_checkpoint
from salsanext_cli.training.learner import Learner
from salsanext_cli.training.log import tensorboard_in, write_log
from salsanext_cli.training.recipe import Recipe

NAME = "c.safetensors"


def learner(classes: int = 3, **changes: object) -> Learner:
    recipe = Recipe(epochs=9, optimiser="adamw", average=0.9).with_changes(**changes)
    return Learner(TinyNetwork(classes), recipe, torch.ones(classes), torch.device("cpu"))


def trained(**changes: object) -> Learner:
    learning = learner(**changes)
    images = torch.randn(2, 5, 16, 16)
    learning.step(images, torch.ones(2, 16, 16, dtype=torch.uint8), 0, 1)
    return learning


def refused(path: Path, learning: Learner, words: str = "") -> None:
    """Fail unless a file is refused in one line, at once, and without taking memory."""
    message = rf"c\.safetensors: cannot be resumed.*{words}"
    with bounded(0), pytest.raises(TrainingError, match=message) as caught:
        load_checkpoint(path, learning)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("changes", [{}, {"average": 0.0}, {"optimiser": "sgd"}])
@pytest.mark.parametrize("steps", [0, 1])
def test_round_trip(tmp_path: Path, changes: dict[str, object], steps: int) -> None:
    rows = [{"epoch": 1, "loss": 2.5}, {"epoch": 2, "loss": 0.1, "miou": 0.25}]
    learning, state = learner(**changes), TrainingState()
    if steps:
        learning, state = trained(**changes), TrainingState(2, 0.5, rows, [0.1, 1 / 3], 3.5)
    save_checkpoint(tmp_path / NAME, learning, state)
    first = (tmp_path / NAME).read_bytes()
    save_checkpoint(tmp_path / NAME, learning, state)
    assert (tmp_path / NAME).read_bytes() == first
    other = learner(**changes)
    assert load_checkpoint(tmp_path / NAME, other) == state
    for mine, theirs in ((learning.module, other.module), (learning.average, other.average)):
        for a, b in zip(mine.state_dict().values(), theirs.state_dict().values(), strict=True):
            assert torch.equal(a, b)
    kept, found = (each.optimiser.state_dict()["state"] for each in (learning, other))
    assert kept.keys() == found.keys()
    for key, values in kept.items():
        assert values.keys() == found[key].keys()
        assert all(torch.equal(value, found[key][name]) for name, value in values.items())


def test_the_scale_of_float16_is_kept(tmp_path: Path) -> None:
    learning = learner(precision="float16")
    learning.scaler.scale(torch.zeros(()))  # a scaler has its state from its first use on
    learning.scaler.update(4096.0)
    save_checkpoint(tmp_path / NAME, learning, TrainingState())
    other = learner(precision="float16")
    load_checkpoint(tmp_path / NAME, other)
    assert other.scaler.get_scale() == 4096


def test_a_checkpoint_of_another_training_or_that_was_cut(tmp_path: Path) -> None:
    save_checkpoint(tmp_path / NAME, trained(), TrainingState(2))
    refused(tmp_path / NAME, learner(classes=4))
    whole = (tmp_path / NAME).read_bytes()
    for cut in (0, 100, -1):
        (tmp_path / NAME).write_bytes(whole[:cut])
        refused(tmp_path / NAME, learner())


@pytest.mark.parametrize("share", [0.0, 0.5, 0.9])
def test_a_flipped_bit_is_noticed(share: float, tmp_path: Path) -> None:
    save_checkpoint(tmp_path / NAME, trained(), TrainingState())
    data = bytearray((tmp_path / NAME).read_bytes())
    start = 8 + struct.unpack("<Q", data[:8])[0]
    data[start + int(share * (len(data) - start))] ^= 4
    (tmp_path / NAME).write_bytes(data)
    refused(tmp_path / NAME, learner(), "the checksum is wrong")


def test_pickles_are_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / NAME).write_bytes(b"cos\nmkdir\n(S'executed'\ntR.")
    refused(tmp_path / NAME, learner())
    assert [path.name for path in tmp_path.iterdir()] == [NAME]


ROWS = [
    {"epoch": 1, "loss": 3.25},
    {"epoch": 2, "loss": 2.5, "miou": 0.25, "iou_car": float("nan"), "iou_road": 0.5},
]
PICTURE = np.zeros((4, 6, 3), np.uint8)


def test_log_has_a_line_per_epoch_and_nothing_where_nothing_was_measured(tmp_path: Path) -> None:
    write_log(tmp_path / "log.csv", ROWS)
    with (tmp_path / "log.csv").open(newline="") as file:
        first, second = csv.DictReader(file)
    empty = {"miou": "", "iou_car": "", "iou_road": ""}
    assert first == {"epoch": "1", "loss": "3.25", **empty}
    assert second == {"epoch": "2", "loss": "2.5", **empty, "miou": "0.25", "iou_road": "0.5"}


def test_an_epoch_is_scalars_and_an_image(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """TensorBoard, which need not be installed, is a mock."""
    tensorboard = MagicMock()
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", tensorboard)
    monkeypatch.setattr(log, "find_spec", lambda name: True)
    with tensorboard_in(tmp_path) as write:
        write(ROWS[1], PICTURE)
    writer = tensorboard.SummaryWriter.return_value.__enter__.return_value
    scalars = [("loss", 2.5, 2), ("miou", 0.25, 2), ("iou/road", 0.5, 2)]
    assert [given.args for given in writer.add_scalar.call_args_list] == scalars
    writer.add_image.assert_called_once_with("sample", PICTURE, 2, dataformats="HWC")


@pytest.mark.drawn
def test_the_curve_has_a_point_per_epoch(tmp_path: Path) -> None:
    log.draw_curve(tmp_path / "curve.png", ROWS)
    assert imread(tmp_path / "curve.png").shape == (480, 840, 4)
