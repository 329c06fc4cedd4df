# SPDX-License-Identifier: MIT
"""Pictures of what changed between two runs on the same scans."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from salsanext_cli.core.geometry.sensor_frame import in_sensor_frame
from salsanext_cli.core.measures.paired import MIN_PARTS, MIN_SCANS, Difference
from salsanext_cli.core.texts import counted, printable, shortened
from salsanext_cli.io.formats import read_scan
from salsanext_cli.report import canvas
from salsanext_cli.report.canvas import DARK, PALE
from salsanext_cli.report.colours import Colours, legend_of, screen_colours
from salsanext_cli.report.plots import GREEN, RED
from salsanext_cli.report.scan_pictures import scan_picture
from salsanext_cli.report.tables import percent
from salsanext_cli.runs.results.recorded_origins import sensor_of_result
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.summary.run_comparison import RunComparison, ScanChange
from salsanext_cli.runs.summary.run_pair import PairedLabels, RunPair

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from salsanext_cli.core.classes.label_space import LabelSpace, TrainIds

CHANGES = {
    "same label": (92, 100, 112),
    "other label": (250, 205, 60),
    "now right": (70, 200, 110),
    "now wrong": (255, 72, 48),
}
"""Colours of points by how their label changed."""
ROW_PX = 26
NAMES_PX = 190  # Width of the names of scores
AXES_PX = 600
SCORES_PX = 130  # Width of the scores before and after
CHANGES_PX = 230  # Width of the changes in numbers
GAP_PX = 18  # Distance of the numbers from the axes
SCORES_LEFT = 1 + GAP_PX / AXES_PX  # As a share of the width of the axes
CHANGES_LEFT = 1 + (GAP_PX + SCORES_PX) / AXES_PX
SCORES_ABOVE_PX = 124  # Height of the title and the legend of scores
AGREEMENT_ABOVE_PX = 80
HEADINGS_PX = SCORES_ABOVE_PX - 14
BELOW_PX = 60  # Height of the numbers and the label of the axis
MAX_NAME = 40  # Longest name of a run in a legend
UNCLEAR = "#8a8f98"
FEW_PARTS = f"no intervals: fewer than {MIN_PARTS} drives, or parts of {MIN_SCANS} scans of a drive"
MEANS = 2  # Number of scores of all classes, which come first
LEAST_LIMIT = 1.0  # Least end of the axis, in percentage points


def scores_by_name(comparison: RunComparison) -> dict[str, Difference]:
    """Return accuracy, mean IoU and the IoU of each class in two runs; empty without labels."""
    if comparison.accuracy is None or comparison.iou_mean is None:
        return {}
    ious = {c.name: c.iou for c in comparison.classes if c.iou is not None}
    mean = f"mean IoU, {len(ious)} classes"
    return {"accuracy": comparison.accuracy, mean: comparison.iou_mean} | ious


def has_intervals(comparison: RunComparison) -> bool:
    """Return whether a score of two runs has an interval of its change."""
    return any(score.low is not None for score in scores_by_name(comparison).values())


def many_scores_text(comparison: RunComparison) -> str:
    """State how many scores are judged at once."""
    count = len(scores_by_name(comparison))
    return f"{counted(count, 'score')} judged at once: 1 of 20 without a change is clear by chance"


def change_text(difference: Difference) -> str:
    """Return a change with its interval in percentage points: ``+3.1 (+1.0 … +5.2)``."""
    change = f"{100 * difference.change:+.1f}"
    if difference.low is None or difference.high is None:
        return change
    return f"{change} ({100 * difference.low:+.1f} … {100 * difference.high:+.1f})"


def run_name(folder: str) -> str:
    """Return a short name of the folder of a run."""
    return printable(shortened("/".join(Path(folder).parts[-2:]), MAX_NAME))


def comparison_picture(comparison: RunComparison) -> bytes:
    """Draw the scores of two runs, or without labels the share of equal labels, as a PNG."""
    scores = scores_by_name(comparison)
    return _score_picture(comparison, scores) if scores else _agreement_picture(comparison)


def _score_picture(comparison: RunComparison, scores: Mapping[str, Difference]) -> bytes:
    """Draw a forest plot: the change of each score with its interval, around a line at zero."""
    title = f"Changes of the scores on {counted(comparison.scored, 'scan')} with labels"
    figure, axes = _rows(title, [*scores], SCORES_ABOVE_PX, SCORES_PX + CHANGES_PX)
    axes.axvline(0, color=DARK, linewidth=1.2, zorder=1)
    axes.axhline(MEANS - 0.5, color=PALE, linewidth=1.2, zorder=0)
    for row, difference in enumerate(scores.values()):
        _draw_change(axes, row, difference)
    farthest = max(_farthest(difference) for difference in scores.values())
    limit = 1.08 * max(farthest, LEAST_LIMIT)
    axes.set_xlim(-limit, limit)
    axes.set_xlabel("change in percentage points")
    _head_columns(figure, with_intervals=has_intervals(comparison))
    names = f"from {run_name(comparison.before)} to {run_name(comparison.after)}"
    canvas.text_at(figure, 20, 52, names, 14, DARK)
    for line, text in enumerate(_notes(comparison)):
        canvas.text_at(figure, 20, 76 + 21 * line, text, 12, DARK)
    return canvas.png_of(figure)


def _notes(comparison: RunComparison) -> list[str]:
    """Explain the marks, and state what limits the scores, in words."""
    if not has_intervals(comparison):
        return [FEW_PARTS]
    intervals = "lines: 95 % intervals; filled: clear, the interval excludes 0"
    return [
        f"{intervals} (green: better, orange: worse); hollow: not clear",
        many_scores_text(comparison),
    ]


def _draw_change(axes: Axes, row: int, difference: Difference) -> None:
    """Draw the interval and the change of a score on its row, and write its numbers beside it."""
    colour = UNCLEAR
    if difference.is_clear:
        colour = GREEN if difference.change > 0 else RED
    if difference.low is not None and difference.high is not None:
        interval = (100 * difference.low, 100 * difference.high)
        axes.plot(interval, (row, row), "|-", color=colour, linewidth=2.2, markersize=9, zorder=2)
    inside = colour if difference.is_clear else canvas.PAPER
    style: dict[str, Any] = {"markeredgecolor": colour, "markeredgewidth": 1.8, "markersize": 8}
    axes.plot(100 * difference.change, row, "o", color=inside, zorder=3, **style)
    weight = "bold" if difference.is_clear else "normal"
    scores = f"{percent(difference.before)} → {percent(difference.after)}"
    for left, text in ((SCORES_LEFT, scores), (CHANGES_LEFT, change_text(difference))):
        axes.text(
            left,
            row,
            text,
            transform=axes.get_yaxis_transform(),
            va="center",
            size=9,
            weight=weight,
            color=DARK,
            clip_on=False,
        )


def _farthest(difference: Difference) -> float:
    """Return the largest distance from zero of a change and its interval, percentage points."""
    ends = (difference.change, difference.low or 0.0, difference.high or 0.0)
    return 100 * max(map(abs, ends))


def _head_columns(figure: Figure, *, with_intervals: bool) -> None:
    """Write the headings of the numbers beside the rows."""
    left = NAMES_PX + AXES_PX
    canvas.text_at(figure, left + GAP_PX, HEADINGS_PX, "before → after, %", 12, DARK)
    change = "change (interval)" if with_intervals else "change"
    canvas.text_at(figure, left + GAP_PX + SCORES_PX, HEADINGS_PX, change, 12, DARK)


def _agreement_picture(comparison: RunComparison) -> bytes:
    """Draw the share of the points of each class that have the same label in both runs."""
    classes = [c for c in comparison.classes if c.same is not None]
    same = percent(comparison.agreement, 1, " %")
    title = f"The same label in both runs: {same} of the points"
    figure, axes = _rows(title, [c.name for c in classes], AGREEMENT_ABOVE_PX, CHANGES_PX)
    axes.set_xlim(0, 100)
    for row, change in enumerate(classes):
        share = 100 * (change.same or 0.0)
        axes.barh(row, share, height=0.66, color=UNCLEAR)
        text = f"{share:.1f} % of {counted(change.points, 'point')}"
        axes.text(103, row, text, va="center", size=9, color=DARK, clip_on=False)
    axes.set_xlabel("points of a class in the first run with the same label in the second, in %")
    names = f"first run {run_name(comparison.before)}, second run {run_name(comparison.after)}"
    scans = f"{counted(comparison.scans, 'scan')}, without labels to compare with"
    canvas.text_at(figure, 20, 56, f"{names}; {scans}", 14, DARK)
    return canvas.png_of(figure)


def _rows(title: str, names: Sequence[str], above: int, right: int) -> tuple[Figure, Axes]:
    """Return a figure and its axes with a row for each name, the first at the top.

    `above`, `right`: height above the axes and width beside them, in pixels.
    """
    height = max(1, len(names)) * ROW_PX
    width = NAMES_PX + AXES_PX + right
    place = (NAMES_PX, above, AXES_PX, height)
    figure, axes = canvas.new_plot(width, above + height + BELOW_PX, place)
    canvas.text_at(figure, 20, 25, title, 17, DARK)
    axes.set_yticks(range(len(names)), names, parse_math=False)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.xaxis.label.set_color(DARK)
    canvas.plain_frame(axes, "x")
    return figure, axes


def changed_scan_picture(file: ScanFile, change: ScanChange, runs: RunPair) -> bytes:
    """Draw a scan from above by the labels of both runs, by the truth, and by what changed.

    Parameters
    ----------
    file : ScanFile
        The scan.
    change : ScanChange
        How much of it changed.
    runs : RunPair
        Folders and classes of both runs.

    Returns
    -------
    bytes
        Content of a PNG file.
    """
    scan = read_scan(file.path, runs.sensor)
    labels = runs.labels_of(file)
    true_labels = runs.truth_of(file, len(labels.before))
    truth = true_labels.train if true_labels else None
    shown = {"first run": labels.before, "second run": labels.after}
    if truth is not None:
        shown["truth"] = truth
    class_colours = screen_colours(runs.space)
    views = {title: class_colours[train] for title, train in shown.items()}
    views["changes"] = _change_colours(labels, truth, runs.space)
    legend = [*legend_of(runs.space, *shown.values()), *CHANGES.items()]
    names = f"first run {run_name(str(runs.before))}, second run {run_name(str(runs.after))}"
    heading = f"{file.name}   {percent(change.changed, 1, ' %')} of the labels changed   {names}"
    sensor = sensor_of_result(runs.before, file, scan, runs.sensor)
    points = in_sensor_frame(scan, sensor).points
    return scan_picture(printable(heading), points, views, legend=legend)


def _change_colours(labels: PairedLabels, truth: TrainIds | None, space: LabelSpace) -> Colours:
    """Return the colours (N, 3) of points by how their label changed, as in `CHANGES`."""
    kind = (labels.before != labels.after).astype(np.intp)
    if truth is not None:
        judged = space.scored[truth] & (kind > 0)
        kind[judged & (labels.after == truth)] = 2
        kind[judged & (labels.before == truth)] = 3
    return np.array(list(CHANGES.values()), np.uint8)[kind]
