# SPDX-License-Identifier: MIT
import csv
import sys
from pathlib import Path
from unittest.mock import MagicMock

import numpy as np
import pytest
from matplotlib.image import imread

from salsanext_cli.training import log
from salsanext_cli.training.log import tensorboard_in, write_log

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
