# SPDX-License-Identifier: MIT
"""The picture of a comparison is a forest plot of the changes of the scores."""

from dataclasses import replace

import pytest
from calls import calls_of
from matplotlib.colors import to_hex

from salsanext_cli.core.measures.paired import Difference
from salsanext_cli.report import canvas
from salsanext_cli.report.plots import GREEN, RED
from salsanext_cli.report.run_changes import FEW_PARTS, UNCLEAR, comparison_picture
from salsanext_cli.runs.summary.run_comparison import ClassChange, RunComparison

SCORES = {
    "accuracy": Difference(before=0.7, after=0.71, low=-0.01, high=0.03),
    "mean IoU, 3 classes": Difference(before=0.4, after=0.46, low=0.02, high=0.1),
    "car": Difference(before=0.9, after=0.8, low=-0.15, high=-0.05),
    "road": Difference(before=0.5, after=0.5, low=None, high=None),
    "$tree$": Difference(before=0.1, after=0.5, low=None, high=None),
}
COLOURS = [UNCLEAR, GREEN, RED, UNCLEAR, UNCLEAR]


@pytest.fixture
def comparison():
    classes = [
        ClassChange(name=name, points=10, same=0.5, iou=difference)
        for name, difference in [*SCORES.items()][2:]
    ]
    return RunComparison(
        before="a",
        after="b",
        label_space="mine",
        scans=9,
        scored=9,
        training_scans=0,
        missing=(),
        not_asked_for=0,
        unknown_ids={},
        parts=9,
        agreement=0.5,
        accuracy=SCORES["accuracy"],
        iou_mean=SCORES["mean IoU, 3 classes"],
        classes=tuple(classes),
        label_changes=(),
        most_changed=(),
        weights=(None, None),
        origins=({}, {}),
    )


def axes_of(comparison):
    """Return the axes that are drawn."""
    with calls_of(canvas.png_of) as calls:
        assert comparison_picture(comparison).startswith(b"\x89PNG")
    (axes,) = calls[0]["figure"].axes
    return axes


def test_each_change_is_on_its_row_with_its_interval_around_zero(comparison):
    axes = axes_of(comparison)
    assert [label.get_text() for label in axes.get_yticklabels()] == [*SCORES]
    rows = {}  # Lines of a row: the interval if there is one, then the change
    for line in axes.lines:
        heights = {float(y) for y in line.get_ydata()}
        if len(heights) == 1 and heights <= {*map(float, range(5))}:
            rows.setdefault(int(heights.pop()), []).append(line)
    for row, (difference, colour) in enumerate(zip(SCORES.values(), COLOURS, strict=True)):
        *intervals, change = rows[row]
        ends = [] if difference.low is None else [(100 * difference.low, 100 * difference.high)]
        assert [tuple(line.get_xdata()) for line in intervals] == ends
        assert list(change.get_xdata()) == [100 * difference.change]
        assert to_hex(change.get_markeredgecolor()) == colour
        filled = colour if difference.is_clear else canvas.PAPER
        assert to_hex(change.get_markerfacecolor()) == to_hex(filled)
    left, right = axes.get_xlim()
    assert (left, right) == (-right, pytest.approx(1.08 * 40))
    zero = [line for line in axes.lines if list(line.get_xdata()) == [0, 0]]
    assert len(zero) == 1
    notes = [text.get_text() for text in axes.figure.texts]
    assert any("5 scores judged at once" in text for text in notes)
    assert FEW_PARTS not in notes
    assert {"car", "90.0 → 80.0", "-10.0 (-15.0 … -5.0)", "+40.0"} <= {
        text.get_text() for text in (*axes.texts, *axes.get_yticklabels())
    }


def test_few_scans_have_a_note_instead_of_intervals(comparison):
    without = Difference(before=0.5, after=0.6, low=None, high=None)
    few = replace(comparison, accuracy=without, iou_mean=without, classes=())
    axes = axes_of(few)
    notes = [text.get_text() for text in axes.figure.texts]
    assert FEW_PARTS in notes
    assert "change" in notes
    assert "change (interval)" not in notes
    assert not any("judged at once" in text or "interval excludes" in text for text in notes)
