# SPDX-License-Identifier: MIT
"""Plots of the evaluation of probabilities and uncertainties."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.measures.confusion import Ratios
from salsanext_cli.measures.risk_coverage import COVERAGE
from salsanext_cli.measures.uncertainty_evaluation import CalibrationResult, RankingResult
from salsanext_cli.report import canvas
from salsanext_cli.report.canvas import DARK
from salsanext_cli.report.colours import screen_colours
from salsanext_cli.report.tables import percent

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.transforms import Bbox

BLUE, SKY, ORANGE, RED, GREEN = "#0072b2", "#56b4e9", "#e69f00", "#d55e00", "#009e73"
PURPLE = "#cc79a7"
"""Colours that colour-blind people can tell apart."""
DASHED = (0, (5, 2))
LINES = {
    "confidence": (DARK, "-"),
    "softmax_entropy": (DARK, DASHED),
    "error": (PURPLE, "-"),
    "epistemic": (BLUE, "-"),
    "mutual_information": (BLUE, DASHED),
    "aleatoric": (ORANGE, "-"),
    "total": (RED, "-"),
    "entropy": (GREEN, "-"),
}
"""Colour and dashes of each kind of uncertainty."""
BEST_ORDER_STYLE: dict[str, Any] = {
    "color": canvas.FAINT,
    "linestyle": (0, (1, 2)),
    "linewidth": 1.4,
}
"""Style of the curve of the best order."""
PLOT_PX = 720, 560
"""Width and height of every plot here, so that their text is of one size on a page."""
LEFT, TOP, WIDTH, TITLE_TOP = 80, 60, 600, 30
"""Place of the main axes and of the title, in pixels."""
HEIGHT, HEIGHT_ABOVE = 430, 330
"""Height of the main axes, and of those that have a legend or other axes below them."""
BELOW_PX = 90
"""Height in pixels of the axes below them, which show the distribution of the points."""
DISTANCES_PX = (9, 16, 26, 40, 56, 76, 100)
"""Distances from a dot to its name in pixels, in the order of the attempts."""
DIRECTIONS_DEG = (0, 180, 90, 270, 30, 330, 150, 210, 60, 300, 120, 240)
"""Directions from a dot to its name in degrees, in the order of the attempts."""
DOT_PX = 6
"""Half the width in pixels of the square around a dot that no name may cover."""


def reliability_diagram(result: CalibrationResult) -> bytes:
    """Draw accuracy against confidence, and the distribution of the points below, as a PNG.

    A bin without points has no bar.
    """
    diagram, scores = result.reliability, result.scores
    title = f"Calibration of the softmax · {scores.points:,} points"
    if scores.points:
        title += f" · ECE {percent(scores.ece, 2, ' %')}"
    figure, axes = _main_plot(title, HEIGHT_ABOVE)
    bins = len(diagram.points)
    edges, width = 100 * np.arange(bins) / bins, 100 / bins
    accuracy = np.nan_to_num(100 * diagram.accuracy)
    gap = np.nan_to_num(100 * diagram.confidence) - accuracy
    axes.bar(edges, accuracy, width, align="edge", color=SKY, edgecolor=canvas.PAPER)
    hatched: dict[str, Any] = {"color": "none", "edgecolor": RED, "linewidth": 0.8, "hatch": "////"}
    label = "gap to the mean confidence"
    axes.bar(edges, gap, width, accuracy, align="edge", label=label, **hatched)
    axes.plot([0, 100], [0, 100], color=DARK, linestyle=DASHED, linewidth=1, label="calibrated")
    axes.set_ylim(0, 100)
    axes.set_ylabel("accuracy in %")
    axes.legend(loc="upper left", frameon=False, fontsize=10)
    below = canvas.axes_at(figure, LEFT, TOP + HEIGHT_ABOVE + 14, WIDTH, BELOW_PX)
    shares = 100 * diagram.points / max(scores.points, 1)
    below.bar(edges, shares, width, align="edge", color=canvas.FAINT, edgecolor=canvas.PAPER)
    below.set_ylabel("points in %")
    below.set_ylim(0, max(1.0, 1.1 * float(shares.max())))
    below.set_xlabel("confidence in %")
    axes.set_xticks(range(0, 101, 20), [""] * 6)
    below.set_xticks(range(0, 101, 20))
    for each in (axes, below):
        each.set_xlim(0, 100)
        canvas.plain_frame(each)
    return canvas.png_of(figure)


def risk_coverage(kinds: Mapping[str, RankingResult]) -> bytes:
    """Draw the share of wrong points among the least uncertain, a curve per kind, as a PNG."""
    curves = {
        kind: (f"AURC {percent(result.scores.aurc, 2, ' %')}", 100 * result.risk_coverage)
        for kind, result in kinds.items()
    }
    return _curves(
        *("Wrong points among those that are kept", 100 * COVERAGE, curves),
        best_orders=[100 * _risk_of_best_order(rate) for rate in _error_rates(kinds)],
        xlabel="coverage: least uncertain points that are kept, in %",
        ylabel="risk: wrong points among them, in %",
    )


def sparsification(kinds: Mapping[str, RankingResult]) -> bytes:
    """Draw the share of wrong points that remain as the most uncertain are removed, as a PNG.

    A kind without wrong points has no curve.
    """
    curves = {
        kind: (f"AUSE {result.scores.ause:.3f}", result.risk_coverage / result.risk_coverage[-1])
        for kind, result in kinds.items()
        if result.scores.wrong
    }
    title = "Wrong points that are left as the most uncertain are removed"
    return _curves(
        *(title, 100 * (1 - COVERAGE), curves),
        best_orders=[_risk_of_best_order(rate) / rate for rate in _error_rates(kinds)],
        xlabel="most uncertain points that are removed, in %",
        ylabel="share of wrong points, of that among all",
    )


def _curves(
    title: str,
    x: Ratios,
    curves: Mapping[str, tuple[str, Ratios]],
    best_orders: Sequence[Ratios],
    **axis_labels: str,
) -> bytes:
    """Draw a score and a curve per kind, and the curves of the best orders, as a PNG."""
    figure, axes = _main_plot(title, HEIGHT_ABOVE)
    for kind, (score, y) in curves.items():
        colour, dashes = LINES[kind]
        axes.plot(x, y, color=colour, linestyle=dashes, label=f"{kind} · {score}")
    for i, y in enumerate(best_orders):
        axes.plot(x, y, **BEST_ORDER_STYLE, label="" if i else "best order")
    axes.set(**axis_labels)
    axes.set_xlim(0, 100)
    axes.set_ylim(bottom=0)
    if axes.lines:
        below: dict[str, Any] = {"loc": "upper left", "bbox_to_anchor": (-0.02, -0.15), "ncols": 2}
        axes.legend(frameon=False, fontsize=10, handlelength=2.6, **below)
    canvas.plain_frame(axes)
    return canvas.png_of(figure)


def _error_rates(kinds: Mapping[str, RankingResult]) -> list[float]:
    """Return the different shares of wrong points; kinds may be known of different points."""
    scores = [result.scores for result in kinds.values()]
    return sorted({s.wrong / s.points for s in scores if s.wrong})


def _risk_of_best_order(rate: float) -> Ratios:
    return np.maximum(0, 1 - (1 - rate) / COVERAGE)


def _main_plot(title: str, height: int = HEIGHT) -> tuple[Figure, Axes]:
    """Return a figure and its main axes, of a height in pixels."""
    return canvas.new_plot(*PLOT_PX, (LEFT, TOP, WIDTH, height), title, TITLE_TOP)


def class_uncertainty(result: RankingResult, space: LabelSpace) -> bytes:
    """Draw the mean uncertainty of each class against its number of points, as a PNG.

    `result`: result for epistemic uncertainty; a class that is absent has no dot; `space`: names
    and colours of the classes.
    """
    present = {i: scores for i, scores in result.classes.items() if scores.points}
    points = np.array([scores.points for scores in present.values()], np.float64)
    means = np.array([scores.mean for scores in present.values()])
    title = "Epistemic uncertainty of the classes"
    if not math.isnan(result.class_size_correlation):
        title += f" · rank correlation {result.class_size_correlation:+.2f}"
    figure, axes = _main_plot(title)
    colours = screen_colours(space)[[*present]] / 255
    axes.scatter(points, means, 60, colours, edgecolors=DARK, linewidths=0.8, zorder=3)
    axes.set_xscale("log")
    if present:
        axes.set_xlim(points.min() / 3, points.max() * 3)
    axes.set_ylim(0, max(1.12 * float(means.max(initial=0)), 1e-12))
    axes.ticklabel_format(axis="y", style="sci", scilimits=(-2, 2), useMathText=True)
    axes.set_xlabel("points of the class")
    axes.set_ylabel("mean epistemic uncertainty")
    canvas.plain_frame(axes)
    name_dots(axes, points, means, [space.names[i] for i in present], DARK)
    return canvas.png_of(figure)


def name_dots(axes: Axes, x: Ratios, y: Ratios, names: Sequence[str], colour: str) -> None:
    """Write a name beside each dot, or farther away with a line to it if the place is occupied.

    The axes have their final limits and scales; `x` and `y`, (N,), are in their data coordinates. A
    dollar sign in a name does not start mathematics.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.lines import Line2D
    from matplotlib.transforms import Bbox, IdentityTransform

    dots = axes.transData.transform(np.stack([x, y], axis=1))
    occupied = [Bbox([dot - DOT_PX, dot + DOT_PX]) for dot in dots]
    pixels = IdentityTransform()
    style: dict[str, Any] = {"size": 9, "color": colour, "va": "center", "parse_math": False}
    renderer = FigureCanvasAgg(axes.get_figure(root=True)).get_renderer()  # type: ignore[no-untyped-call]
    for dot, name in zip(dots, names, strict=True):
        text = axes.text(0, 0, name, transform=pixels, **style)
        size = np.array(text.get_window_extent(renderer).size)
        box = _free_place(dot, size, occupied, axes.bbox)
        text.set_position((box.x0, (box.y0 + box.y1) / 2))
        occupied.append(box)
        nearest = np.clip(dot, box.min, box.max)
        if np.linalg.norm(nearest - dot) > DISTANCES_PX[1]:
            ends = np.stack([dot, nearest], axis=1)
            axes.add_line(Line2D(*ends, transform=pixels, color=canvas.FAINT, linewidth=0.7))


def _free_place(dot: Ratios, size: Ratios, occupied: Sequence[Bbox], inside: Bbox) -> Bbox:
    """Return the nearest box of a size that overlaps none and lies inside; all in pixels."""
    from matplotlib.transforms import Bbox

    boxes = []
    for distance in DISTANCES_PX:
        for direction in np.radians(DIRECTIONS_DEG).tolist():
            across, up = distance * math.cos(direction), distance * math.sin(direction)
            side = round(math.cos(direction))
            left, bottom = dot + (across - size[0] * (1 - side) / 2, up - size[1] / 2)
            box = Bbox.from_bounds(left, bottom, *size)
            within = all(inside.contains(*corner) for corner in (box.min, box.max))
            if within and not box.count_overlaps(occupied):
                return box
            boxes.append(box)
    return boxes[0]
