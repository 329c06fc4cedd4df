# SPDX-License-Identifier: MIT
"""Log of a training: a table, a curve, and events for TensorBoard."""

import csv
import io
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import numpy.typing as npt

from salsanext_cli.results.owned_folder import OwnedFolder
from salsanext_cli.training.run_folder import EVENTS

Row = dict[str, float]
"""One epoch: epoch, learning_rate, loss, seconds; where validated, also what `validate` returns."""
EpochWriter = Callable[[Row, npt.NDArray[np.uint8]], None]
"""Writes a finished epoch and its picture, (H, W, 3)."""


def write_log(path: Path, rows: Sequence[Row]) -> None:
    """Write one line per epoch as CSV; cells without a measurement are empty."""
    columns = dict.fromkeys(key for row in rows for key in row)
    text = io.StringIO()
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
    left = figure.add_subplot(xlabel="epoch", ylabel="training loss")
    left.xaxis.set_major_locator(MaxNLocator(integer=True))
    left.plot([row["epoch"] for row in rows], [row["loss"] for row in rows], "C0.-")
    left.yaxis.label.set_color("C0")
    right = left.twinx()
    validated = [row for row in rows if "miou" in row]
    right.plot([row["epoch"] for row in validated], [row["miou"] for row in validated], "C1.-")
    right.set(ylabel="validation mIoU on points", ylim=(0, 1))
    right.yaxis.label.set_color("C1")
    left.set_title("Training")
    with OwnedFolder(path.parent).writing(path) as file:
        figure.savefig(file, format="png", dpi=120)


@contextmanager
def tensorboard_in(run: Path, *, wanted: bool = True) -> Iterator[EpochWriter]:
    """Yield the writer of epochs for TensorBoard; without TensorBoard it writes nothing."""
    if not wanted or find_spec("tensorboard") is None:
        yield lambda row, picture: None
        return
    from torch.utils.tensorboard import SummaryWriter  # an optional dependency

    folder, owned = run / EVENTS, OwnedFolder(run)
    before = {*folder.glob("events.*")}
    with SummaryWriter(str(folder)) as writer:

        def write(row: Row, picture: npt.NDArray[np.uint8]) -> None:
            epoch = int(row["epoch"])
            for key, value in row.items():
                if key != "epoch" and value == value:
                    writer.add_scalar(key.replace("iou_", "iou/", 1), value, epoch)
            writer.add_image("sample", picture, epoch, dataformats="HWC")
            writer.flush()
            for path in {*folder.glob("events.*")} - before:
                owned.add(path)

        yield write
