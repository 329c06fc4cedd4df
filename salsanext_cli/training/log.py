# SPDX-License-Identifier: MIT
"""Log of a training: a table and a curve."""

import csv
import io
from collections.abc import Sequence
from pathlib import Path

from salsanext_cli.results.owned_folder import OwnedFolder

Row = dict[str, float]
"""One epoch: epoch, learning_rate, loss, seconds; if validated, also what `validate` returns."""


def write_log(path: Path, rows: Sequence[Row]) -> None:
    """Write one line per epoch as CSV; cells without a measurement are empty."""
    text = io.StringIO()
    columns = dict.fromkeys(key for row in rows for key in row)
    table = csv.DictWriter(text, columns, lineterminator="\n")
    table.writeheader()
    table.writerows({key: _cell(value) for key, value in row.items()} for row in rows)
    OwnedFolder(path.parent).write(path, text.getvalue().encode())


def _cell(value: float) -> str:
    if value != value:
        return ""
    return str(value) if isinstance(value, int) else f"{value:.6g}"


def draw_curve(path: Path, rows: Sequence[Row]) -> None:
    """Draw loss and validation mIoU over epochs as PNG."""
    from matplotlib.figure import Figure  # a second to import, and only this needs it
    from matplotlib.ticker import MaxNLocator

    figure = Figure(figsize=(7, 4))
    # A layout fitted to the text would take twice the time, after every epoch.
    figure.subplots_adjust(left=0.11, right=0.91, bottom=0.12, top=0.92)
    left = figure.add_subplot(title="Training", xlabel="epoch", ylabel="training loss")
    left.xaxis.set_major_locator(MaxNLocator(integer=True))
    left.plot([row["epoch"] for row in rows], [row["loss"] for row in rows], "C0.-")
    left.yaxis.label.set_color("C0")
    right = left.twinx()
    validated = [row for row in rows if "miou" in row]
    right.plot([row["epoch"] for row in validated], [row["miou"] for row in validated], "C1.-")
    right.set(ylabel="validation mIoU on points", ylim=(0, 1))
    right.yaxis.label.set_color("C1")
    with OwnedFolder(path.parent).writing(path) as file:
        figure.savefig(file, format="png", dpi=120)
