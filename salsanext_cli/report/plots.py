# SPDX-License-Identifier: MIT
"""Plots of scores, confusions, probabilities and uncertainty."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.measures.calibration import Reliability
from salsanext_cli.core.measures.scores import Counts, Scores, ratio, scored_rows
from salsanext_cli.core.measures.uncertainty_evaluation import (
    COVERAGE,
    RankingScores,
    UncertaintyEvaluation,
)
from salsanext_cli.report import canvas
from salsanext_cli.report.canvas import DARK
from salsanext_cli.report.colours import screen_colours
from salsanext_cli.report.tables import percent

PICTURES = {
    "eval_iou.png": "IoU of every class",
    "eval_confusion.png": "Confusion matrix",
    "eval_reliability.png": "Calibration of the softmax: accuracy against confidence",
    "eval_error.png": "Calibration of the error: share of wrong points against the error",
    "eval_risk_coverage.png": "Share of wrong points among the least uncertain points",
}
"""Titles of all plots by the name of the file."""
ROW_PX = 28
CELL_PX = 46
NAMES_PX = 150
MIN_SHARE = 0.005  # Shares below this round to 0 % and are not written into their cell
DASHED = (0, (5, 2))
SOLID = "-"
BLUE = "#0072b2"
SKY = "#56b4e9"
ORANGE = "#e69f00"
RED = "#d55e00"
GREEN = "#009e73"
PURPLE = "#cc79a7"
"""Colours that colour-blind people can distinguish."""
LINES = {
    "softmax_entropy": (DARK, DASHED),
    "error": (PURPLE, SOLID),
    "epistemic": (BLUE, SOLID),
    "aleatoric": (ORANGE, SOLID),
    "total": (RED, SOLID),
    "entropy": (GREEN, SOLID),
    "mutual_information": (BLUE, DASHED),
    "least_confidence": (SKY, SOLID),
    "disagreement": (PURPLE, DASHED),
}
"""Colour and dashes of each kind of uncertainty."""
PLOT_PX = 720, 560  # Size of the plots of uncertainty: text has one size on a page
MAIN_PX = 80, 60, 600, 330  # Axes above a legend or other axes
LEFT, TOP, WIDTH, HEIGHT = MAIN_PX
BELOW_PX = 90  # Height of the axes below them, which show the distribution of the points


def uncertainty_pictures(uncertainty: UncertaintyEvaluation) -> dict[str, bytes]:
    """Draw the results for probabilities and uncertainty: PNG by name, as in `PICTURES`."""
    pictures = {}
    if uncertainty.calibration:
        diagram = uncertainty.calibration.reliability
        png = reliability_diagram(diagram, "softmax", "confidence", "accuracy")
        pictures["eval_reliability.png"] = png
    error = uncertainty.kinds.get("error")
    if error and error.reliability:
        png = reliability_diagram(error.reliability, "error", "error", "share of wrong points")
        pictures["eval_error.png"] = png
    if uncertainty.kinds:
        pictures["eval_risk_coverage.png"] = risk_coverage(uncertainty.kinds)
    return pictures


def iou_picture(result: Scores, space: LabelSpace) -> bytes:
    """Draw the IoU of every class in the truth as a bar in its colour, as a PNG."""
    height = ROW_PX * len(result.classes)
    title = (
        f"IoU · {result.points:,} labelled points · accuracy {percent(result.accuracy, 1, ' %')}"
    )
    figure, axes = canvas.new_plot(900, height + 130, (NAMES_PX, 70, 690, height), title)
    rows = range(len(result.classes))
    shares = [100 * c.iou if c.points else math.nan for c in result.classes]
    colours = screen_colours(space)[[c.train_id for c in result.classes]] / 255
    axes.barh(rows, np.nan_to_num(shares), 0.72, color=colours, edgecolor=DARK, linewidth=0.6)
    box = {"facecolor": canvas.PAPER, "edgecolor": "none", "pad": 1.5}
    for row, share in zip(rows, shares, strict=True):
        is_absent = math.isnan(share)
        text = "absent" if is_absent else f"{share:.1f}"
        colour = canvas.FAINT if is_absent else DARK
        left = 1 if is_absent else share + 1
        axes.text(left, row, text, color=colour, fontsize=9, va="center_baseline", bbox=box)
    mean = 100 * result.iou_mean_present
    if not math.isnan(mean):
        axes.axvline(mean, color=DARK, linewidth=1, linestyle=DASHED)
        text = f"mean of classes present {mean:.1f}"
        axes.text(mean, -0.8, text, ha="center", fontsize=9, color=DARK)
    axes.set_yticks(rows, [c.name for c in result.classes], parse_math=False)
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.set_xlim(0, 108)
    axes.set_xticks(range(0, 101, 20))
    axes.set_xlabel("IoU in %")
    canvas.plain_frame(axes, "x")
    return canvas.png_of(figure)


def confusion_picture(confusion: Counts, space: LabelSpace) -> bytes:
    """Draw the confusion matrix, each row in percent of its true class, as a PNG."""
    import matplotlib

    matrix = scored_rows(confusion, space)
    scored = np.flatnonzero(space.scored)
    predicted = np.arange(space.class_count)
    shares = ratio(matrix, np.broadcast_to(matrix.sum(axis=1)[:, None], matrix.shape))[scored]
    width = CELL_PX * len(predicted)
    height = CELL_PX * len(scored)
    size = (width + NAMES_PX + 50, height + NAMES_PX + 10)
    figure, axes = canvas.new_plot(*size, (NAMES_PX, 30, width, height))
    blues = matplotlib.colormaps["Blues"].with_extremes(bad="#eceef1")
    axes.imshow(np.ma.masked_invalid(shares), cmap=blues, vmin=0, vmax=1, aspect="auto")
    for (row, column), share in np.ndenumerate(shares):
        if share >= MIN_SHARE:
            colour = "white" if share > 0.5 else DARK
            text = f"{100 * share:.0f}"
            axes.text(column, row, text, color=colour, ha="center", va="center", size=9)
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


def reliability_diagram(diagram: Reliability, title: str, value: str, share: str) -> bytes:
    """Draw a share against a value, and the distribution of the points below, as a PNG."""
    points = int(diagram.points.sum())
    title = f"Calibration of the {title} · {points:,} points"
    title += f" · ECE {percent(diagram.error, 2, ' %')}" if points else ""
    figure, axes = canvas.new_plot(*PLOT_PX, MAIN_PX, title)
    bins = len(diagram.points)
    edges = 100 * np.arange(bins) / bins
    width = 100 / bins
    shares = np.nan_to_num(100 * diagram.accuracy)
    gap = np.nan_to_num(100 * diagram.confidence) - shares
    axes.bar(edges, shares, width, align="edge", color=SKY, edgecolor=canvas.PAPER)
    hatched: dict[str, Any] = {"color": "none", "edgecolor": RED, "linewidth": 0.8, "hatch": "////"}
    label = f"gap to the mean {value}"
    axes.bar(edges, gap, width, shares, align="edge", label=label, **hatched)
    axes.plot([0, 100], [0, 100], color=DARK, linestyle=DASHED, linewidth=1, label="calibrated")
    axes.set_ylim(0, 100)
    axes.set_ylabel(f"{share} in %")
    axes.legend(loc="upper left", frameon=False, fontsize=10)
    below = canvas.axes_at(figure, LEFT, TOP + HEIGHT + 14, WIDTH, BELOW_PX)
    points_in_bin = 100 * diagram.points / max(points, 1)
    below.bar(edges, points_in_bin, width, align="edge", color=canvas.FAINT, edgecolor=canvas.PAPER)
    below.set_ylabel("points in %")
    below.set_ylim(0, max(1.0, 1.1 * float(points_in_bin.max())))
    below.set_xlabel(f"{value} in %")
    axes.set_xticks(range(0, 101, 20), [""] * 6)
    below.set_xticks(range(0, 101, 20))
    for panel in (axes, below):
        panel.set_xlim(0, 100)
        canvas.plain_frame(panel)
    return canvas.png_of(figure)


def risk_coverage(kinds: Mapping[str, RankingScores]) -> bytes:
    """Draw the share of wrong points among the least uncertain, a curve per kind, as a PNG."""
    title = "Share of wrong points among the accepted points"
    figure, axes = canvas.new_plot(*PLOT_PX, MAIN_PX, title)
    for kind, scores in kinds.items():
        colour, dashes = LINES[kind]
        name = kind.replace("_", " ")
        label = f"{name} · AURC {percent(scores.aurc, 2, ' %')}"
        risk = 100 * scores.risk_coverage
        axes.plot(100 * COVERAGE, risk, color=colour, linestyle=dashes, label=label)
    dotted: dict[str, Any] = {"color": canvas.FAINT, "linestyle": (0, (1, 2)), "linewidth": 1.4}
    # Kinds may be known of different points, with different shares of wrong ones.
    rates = {scores.wrong / scores.points for scores in kinds.values() if scores.wrong}
    for i, rate in enumerate(sorted(rates)):
        risk = np.maximum(0, 1 - (1 - rate) / COVERAGE)
        axes.plot(100 * COVERAGE, 100 * risk, **dotted, label="" if i else "best order")
    axes.set_xlabel("coverage: least uncertain points that are accepted, in %")
    axes.set_ylabel("risk: wrong points among them, in %")
    axes.set_xlim(0, 100)
    axes.set_ylim(bottom=0)
    below: dict[str, Any] = {"loc": "upper left", "bbox_to_anchor": (-0.02, -0.15), "ncols": 2}
    axes.legend(frameon=False, fontsize=10, handlelength=2.6, **below)
    canvas.plain_frame(axes)
    return canvas.png_of(figure)
