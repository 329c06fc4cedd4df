# SPDX-License-Identifier: MIT
"""The course of a training as a table and as a picture."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path

from salsanext_cli.storage.atomic import write_text, writing

Row = dict[str, float]
"""One epoch: epoch, learning_rate, loss, seconds and, where validated, miou and iou_<class>."""


def write_log(path: Path, rows: Sequence[Row]) -> None:
    """Write one line per epoch as CSV; what was not measured is empty."""
    columns = dict.fromkeys(key for row in rows for key in row)
    text = io.StringIO()
    table = csv.DictWriter(text, columns, lineterminator="\n")
    table.writeheader()
    table.writerows({key: _written(value) for key, value in row.items()} for row in rows)
    write_text(path, text.getvalue())


def _written(value: float) -> str:
    if value != value:
        return ""
    return str(value) if isinstance(value, int) else f"{value:.6g}"


def draw_curve(path: Path, rows: Sequence[Row]) -> None:
    """Draw loss and validation mIoU over epochs as PNG."""
    from matplotlib.figure import Figure  # a second to import, and only this needs it

    figure = Figure(figsize=(7, 4), layout="constrained")
    left = figure.add_subplot(xlabel="epoch", ylabel="training loss")
    left.plot([row["epoch"] for row in rows], [row["loss"] for row in rows], "C0.-")
    left.yaxis.label.set_color("C0")
    right = left.twinx()
    validated = [row for row in rows if "miou" in row]
    right.plot([row["epoch"] for row in validated], [row["miou"] for row in validated], "C1.-")
    right.set(ylabel="validation mIoU on points", ylim=(0, 1))
    right.yaxis.label.set_color("C1")
    left.set_title("Training")
    with writing(path) as file:
        figure.savefig(file, format="png", dpi=120)
