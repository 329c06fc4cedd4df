# SPDX-License-Identifier: MIT
import csv
from pathlib import Path

from salsanext_cli.training.log import draw_curve, write_log

ROWS = [
    {"epoch": 1, "loss": 3.25},
    {"epoch": 2, "loss": 2.5, "miou": 0.25, "iou_car": float("nan"), "iou_road": 0.5},
]


def test_log_has_a_line_per_epoch_and_nothing_where_nothing_was_measured(tmp_path: Path) -> None:
    write_log(tmp_path / "log.csv", ROWS)
    with (tmp_path / "log.csv").open(newline="") as file:
        first, second = csv.DictReader(file)
    assert first == {"epoch": "1", "loss": "3.25", "miou": "", "iou_car": "", "iou_road": ""}
    assert second == {
        "epoch": "2",
        "loss": "2.5",
        "miou": "0.25",
        "iou_car": "",
        "iou_road": "0.5",
    }


def test_curve_is_a_picture(tmp_path: Path) -> None:
    for rows in (ROWS, ROWS[:1]):
        draw_curve(tmp_path / "curve.png", rows)
        assert (tmp_path / "curve.png").read_bytes().startswith(b"\x89PNG")
