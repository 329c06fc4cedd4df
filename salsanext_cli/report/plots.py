# SPDX-License-Identifier: MIT
"""Plots of scores, the confusion matrix and the search for a dropout rate."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.measures.confusion import Confusion, ratio
from salsanext_cli.measures.scores import Scores
from salsanext_cli.measures.uncertainty_evaluation import UncertaintyEvaluation
from salsanext_cli.report import canvas, plots, uncertainty_plots
from salsanext_cli.report.canvas import DARK
from salsanext_cli.report.colours import screen_colours
from salsanext_cli.report.tables import percent

PICTURES = {
    "eval_iou.png": "IoU of every class",
    "eval_confusion.png": "Confusion matrix",
    "eval_reliability.png": "Calibration of the softmax: accuracy against confidence",
    "eval_risk_coverage.png": "Wrong points among the least uncertain ones",
    "eval_sparsification.png": "Wrong points that are left as the most uncertain are removed",
    "eval_class_uncertainty.png": "Mean epistemic uncertainty of the classes",
}
"""All plots, by the name of the file, in words."""
ROW_PX = 28
"""Height of a class in the bar plot."""
CELL_PX = 46
"""Height and width of a cell of the matrix."""
NAMES_PX = 150
"""Space for the names of classes."""
SMALLEST_SHARE = 0.005
"""Shares below this round to 0 % and are not written into their cell."""
BEST_COLOUR = "#b3472f"


def evaluation_pictures(
    scores: Scores, confusion: Confusion, uncertainty: UncertaintyEvaluation, space: LabelSpace
) -> dict[str, bytes]:
    """Draw what there is to an evaluation, PNG by name, in the order of `PICTURES`."""
    scored = {
        "eval_iou.png": plots.iou_bars(scores, space),
        "eval_confusion.png": plots.confusion_picture(confusion, space),
    }
    return scored | uncertainty_pictures(uncertainty, space)


def uncertainty_pictures(uncertainty: UncertaintyEvaluation, space: LabelSpace) -> dict[str, bytes]:
    """Draw what there is to probabilities and uncertainties, as `evaluation_pictures`."""
    pictures = {}
    if uncertainty.calibration:
        diagram = uncertainty_plots.reliability_diagram(uncertainty.calibration)
        pictures["eval_reliability.png"] = diagram
    if uncertainty.kinds:
        pictures["eval_risk_coverage.png"] = uncertainty_plots.risk_coverage(uncertainty.kinds)
        pictures["eval_sparsification.png"] = uncertainty_plots.sparsification(uncertainty.kinds)
    if epistemic := uncertainty.kinds.get("epistemic"):
        picture = uncertainty_plots.class_uncertainty(epistemic, space)
        pictures["eval_class_uncertainty.png"] = picture
    return pictures


def iou_bars(result: Scores, space: LabelSpace) -> bytes:
    """Draw the IoU of every class as a bar in the class's colour, as a PNG.

    `result`: scores to draw; a class that is absent from the truth has no bar; `space`: colours of
    the classes.
    """
    height = ROW_PX * len(result.classes)
    title = f"{result.points:,} labelled points · accuracy {percent(result.accuracy, 1, ' %')}"
    figure, axes = canvas.new_plot(900, height + 130, (NAMES_PX, 70, 690, height), title)
    places = range(len(result.classes))
    shares = [100 * c.iou if c.points else math.nan for c in result.classes]
    colours = screen_colours(space)[[c.train_id for c in result.classes]] / 255
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
    mean = 100 * result.iou_mean_present
    if not math.isnan(mean):
        axes.axvline(mean, color=DARK, linewidth=1, linestyle=(0, (4, 3)))
        text = f"mean of classes present {mean:.1f}"
        axes.text(mean, -0.8, text, ha="center", fontsize=9, color=DARK)
    axes.set_yticks(places, [c.name for c in result.classes], parse_math=False)
    axes.set_ylim(len(places) - 0.5, -0.5)
    axes.set_xlim(0, 108)
    axes.set_xticks(range(0, 101, 20))
    axes.set_xlabel("IoU in %")
    canvas.plain_frame(axes, "x")
    return canvas.png_of(figure)


def confusion_picture(confusion: Confusion, space: LabelSpace) -> bytes:
    """Draw the confusion matrix, each row in percent of its true class, as a PNG.

    `confusion`: counts over the train ids of `space`; `space`: names of the classes; ignored ones
    have a column, but no row.
    """
    import matplotlib

    matrix = confusion.counted(space.scored)
    scored, predicted = np.flatnonzero(space.scored), np.arange(space.class_count)
    shares = ratio(matrix, np.broadcast_to(matrix.sum(axis=1)[:, None], matrix.shape))[scored]
    width, height = CELL_PX * len(predicted), CELL_PX * len(scored)
    size = (width + NAMES_PX + 50, height + NAMES_PX + 10)
    figure, axes = canvas.new_plot(*size, (NAMES_PX, 30, width, height))
    blues = matplotlib.colormaps["Blues"].with_extremes(bad="#eceef1")
    axes.imshow(np.ma.masked_invalid(shares), cmap=blues, vmin=0, vmax=1, aspect="auto")
    for (row, column), share in np.ndenumerate(shares):
        if share >= SMALLEST_SHARE:
            colour = "white" if share > 0.5 else DARK
            axes.text(
                column, row, f"{100 * share:.0f}", color=colour, ha="center", va="center", size=9
            )
    names = space.names
    axes.set_yticks(range(len(scored)), [names[i] for i in scored], parse_math=False)
    slanted: dict[str, Any] = {"rotation": 45, "ha": "right", "rotation_mode": "anchor"}
    axes.set_xticks(range(len(predicted)), names, parse_math=False, **slanted)
    for row in np.flatnonzero(np.isnan(shares[:, 0])).tolist():
        axes.text(0, row, "no points", color=canvas.FAINT, va="center", size=9)
    axes.set_xticks(np.arange(len(predicted) + 1) - 0.5, minor=True)
    axes.set_yticks(np.arange(len(scored) + 1) - 0.5, minor=True)
    axes.grid(which="minor", color=canvas.PAPER, linewidth=1)
    axes.set_ylabel("truth")
    axes.set_xlabel("prediction, % of the true class's points")
    canvas.plain_frame(axes, None)
    return canvas.png_of(figure)


def rate_curve(
    path: Path, rates: Sequence[float], objectives: Sequence[float], best: float
) -> None:
    """Draw the objective over the dropout rate, logarithmic, the best rate marked, as a PNG."""
    title = f"least at a dropout rate of {best:.3g}"
    figure, axes = canvas.new_plot(760, 460, (90, 50, 640, 340), title)
    axes.plot(rates, objectives, color=DARK, marker="o", markersize=5, linewidth=1.2)
    axes.axvline(best, color=BEST_COLOUR, linewidth=1, linestyle=(0, (4, 3)))
    axes.set_xscale("log")
    axes.set_xticks(rates, [f"{rate:.2g}" for rate in rates])
    axes.minorticks_off()
    axes.set_xlabel("dropout rate")
    axes.set_ylabel("objective per point")
    canvas.plain_frame(axes)
    canvas.save_png(figure, path)
