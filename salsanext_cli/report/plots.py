# SPDX-License-Identifier: MIT
"""Plots of scores: a bar per class, and the confusion matrix."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from salsanext_cli.classes import LabelSpace
from salsanext_cli.measures.confusion import Confusion, ratio
from salsanext_cli.measures.scores import Scores
from salsanext_cli.report import canvas
from salsanext_cli.report.canvas import DARK
from salsanext_cli.report.numbers import percent

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Colormap

ROW = 28
"""Pixels per class of the bar plot."""
CELL = 46
"""Pixels per cell of the matrix."""
NAMES = 150
"""Pixels for the names of classes."""
SMALLEST_SHARE = 0.005
"""Shares below this round to 0 % and are not written into their cell."""


def iou_bars(path: Path, result: Scores, space: LabelSpace) -> None:
    """Draw the IoU of every class as a bar in the class's colour, as a PNG.

    Parameters
    ----------
    path : Path
        Where to write.
    result : Scores
        What to draw; a class that is absent has no bar.
    space : LabelSpace
        Whose colours to take.
    """
    height = ROW * len(result.classes)
    figure = canvas.new_figure(900, height + 130, canvas.PAPER)
    axes = canvas.axes_at(figure, NAMES, 70, 690, height)
    places = range(len(result.classes))
    shares = [100 * c.iou for c in result.classes]
    colours = [space.colours[c.train_id] / 255 for c in result.classes]
    axes.barh(places, np.nan_to_num(shares), 0.72, color=colours, edgecolor=DARK, linewidth=0.6)
    for place, share in zip(places, shares, strict=True):
        absent = math.isnan(share)
        text, colour = ("absent", canvas.FAINT) if absent else (f"{share:.1f}", DARK)
        axes.text(
            *((0 if absent else share) + 1, place, text),
            color=colour,
            fontsize=9,
            va="center_baseline",
            bbox={"facecolor": canvas.PAPER, "edgecolor": "none", "pad": 1.5},
        )
    _mark_mean(axes, result, len(places))
    axes.set_yticks(places, [c.name for c in result.classes], parse_math=False)
    axes.set_ylim(len(places) - 0.5, -0.5)
    axes.set_xlim(0, 108)
    axes.set_xticks(range(0, 101, 20))
    axes.set_xlabel("IoU in %")
    canvas.draw_grid(axes, "x")
    canvas.plain_frame(axes)
    title = f"{result.points:,} labelled points · accuracy {percent(result.accuracy, 1, ' %')}"
    canvas.text_at(figure, NAMES, 25, title, 17, DARK)
    canvas.save_png(figure, path)


def _mark_mean(axes: Axes, result: Scores, count: int) -> None:
    mean = 100 * result.iou_mean_present
    if math.isnan(mean):
        return
    axes.axvline(mean, color=DARK, linewidth=1, linestyle=(0, (4, 3)))
    axes.text(
        mean, -0.8, f"mean of classes present {mean:.1f}", ha="center", fontsize=9, color=DARK
    )


def confusion_picture(path: Path, confusion: Confusion, space: LabelSpace) -> None:
    """Draw the confusion matrix, each row in percent of its true class, as a PNG.

    Parameters
    ----------
    path : Path
        Where to write.
    confusion : Confusion
        Counts over the train ids of `space`.
    space : LabelSpace
        Names the classes; ignored ones have no row, but the column of what was predicted.
    """
    matrix = confusion.counted(space.scored)
    scored, predicted = np.flatnonzero(space.scored), np.arange(space.class_count)
    shares = ratio(matrix, np.broadcast_to(matrix.sum(axis=1)[:, None], matrix.shape))[scored]
    width, height = CELL * len(predicted), CELL * len(scored)
    figure = canvas.new_figure(width + NAMES + 50, height + NAMES + 10, canvas.PAPER)
    axes = canvas.axes_at(figure, NAMES, 30, width, height)
    axes.imshow(np.ma.masked_invalid(shares), cmap=_blues(), vmin=0, vmax=1, aspect="auto")
    for (row, column), share in np.ndenumerate(shares):
        if share >= SMALLEST_SHARE:
            colour = "white" if share > 0.5 else DARK
            axes.text(
                column, row, f"{100 * share:.0f}", color=colour, ha="center", va="center", size=9
            )
    names = space.names
    axes.set_yticks(range(len(scored)), [names[i] for i in scored], parse_math=False)
    axes.set_xticks(
        range(len(predicted)),
        names,
        rotation=45,
        ha="right",
        rotation_mode="anchor",
        parse_math=False,
    )
    for row in np.flatnonzero(np.isnan(shares[:, 0])).tolist():
        axes.text(0, row, "no points", color=canvas.FAINT, va="center", size=9)
    axes.set_xticks(np.arange(len(predicted) + 1) - 0.5, minor=True)
    axes.set_yticks(np.arange(len(scored) + 1) - 0.5, minor=True)
    axes.grid(which="minor", color=canvas.PAPER, linewidth=1)
    axes.set_ylabel("truth")
    axes.set_xlabel("prediction, % of the true class's points")
    canvas.plain_frame(axes)
    canvas.save_png(figure, path)


def _blues() -> Colormap:
    import matplotlib

    return matplotlib.colormaps["Blues"].with_extremes(bad="#eceef1")
