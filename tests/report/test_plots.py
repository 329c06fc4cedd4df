# SPDX-License-Identifier: MIT
"""Plots of an evaluation show its numbers."""

from io import BytesIO

import numpy as np
import pytest
from class_colours import CAR, ROAD, SPACE, rgb
from evaluation_runs import calibration_result, ranking_result, small_space
from matplotlib.image import imread

from salsanext_cli.core.measures.scores import Counts, confusion_matrix, scores
from salsanext_cli.report.colours import screen_colours
from salsanext_cli.report.plots import (
    CELL_PX,
    HEIGHT,
    LEFT,
    NAMES_PX,
    PLOT_PX,
    ROW_PX,
    SKY,
    TOP,
    WIDTH,
    confusion_picture,
    iou_picture,
    reliability_diagram,
    risk_coverage,
)


def counts() -> Counts:
    """Every car right, half of the road unlabelled, all other classes absent."""
    truth, predicted = np.array([[CAR, CAR, ROAD, ROAD, 0], [CAR, CAR, ROAD, 0, CAR]])
    return confusion_matrix(truth, predicted, SPACE.class_count)


def pixels(png: bytes) -> np.ndarray:
    return (imread(BytesIO(png))[:, :, :3] * 255).round().astype(int)


def test_cells_are_as_dark_as_the_share_of_the_row_with_any_points_and_names():
    picture = pixels(confusion_picture(counts(), SPACE))

    def cell(truth, predicted):
        row, column = 30 + (truth - 1) * CELL_PX, NAMES_PX + predicted * CELL_PX
        return picture[row + 5, column + 5].sum()

    assert cell(CAR, CAR) < cell(ROAD, ROAD) < cell(CAR, ROAD)
    # The row of an absent class is grey from end to end.
    grey = picture[30 + 5 * CELL_PX + 5, NAMES_PX + 5]
    assert grey.max() - grey.min() < 10
    assert cell(6, 3) == cell(6, 6) < cell(CAR, ROAD)
    space = small_space("none", "$\\frac{$ [b]", "Straße")
    some = confusion_matrix(np.array([1, 2]), np.array([1, 1]), 3)
    for confusion in (np.zeros_like(some), some):
        assert pixels(confusion_picture(confusion, space)).size


def test_bars_are_as_long_as_the_iou_in_the_colour_of_the_class():
    picture = pixels(iou_picture(scores(counts(), SPACE), SPACE))
    lengths = {}
    for train in (CAR, ROAD, 6):
        row = picture[70 + (train - 1) * ROW_PX + ROW_PX // 2 - 7]
        colour = screen_colours(SPACE)[train]
        lengths[train] = (row == colour).all(axis=-1).sum() / (690 / 1.08)
    # A third of the points labelled car are unlabelled in the truth, which do not count.
    assert lengths[CAR] == pytest.approx(1, abs=0.02)
    assert lengths[ROAD] == pytest.approx(0.5, abs=0.02)
    assert lengths[6] == 0
    space = small_space("none", "$\\frac{$ [b]", "Straße")
    nothing = np.zeros((3, 3), np.int64)
    assert pixels(iou_picture(scores(nothing, space), space)).size


def rows_of(picture, colour, x) -> np.ndarray:
    """Return how high a colour reaches in a column of the axes: 0 at the bottom, 1 at the top."""
    column = picture[TOP : TOP + HEIGHT + 1, LEFT + round(x * WIDTH)]
    near = np.abs(column - rgb(colour)).sum(axis=-1) < 60
    return 1 - np.flatnonzero(near) / HEIGHT


def test_bars_are_as_high_as_the_accuracy():
    result = calibration_result([1] * 6 + [2] * 4).reliability
    picture = pixels(reliability_diagram(result, "softmax", "confidence", "accuracy"))
    assert rows_of(picture, SKY, 11.5 / 15).max() == pytest.approx(0.6, abs=0.01)
    assert not rows_of(picture, SKY, 5.5 / 15).size


@pytest.mark.parametrize("count", [0, 2])
def test_plots_have_one_size_with_and_without_points(count):
    result = ranking_result([0.1] * count, np.zeros(count, bool))
    for picture in (
        risk_coverage({"epistemic": result}),
        reliability_diagram(
            calibration_result([]).reliability, "softmax", "confidence", "accuracy"
        ),
    ):
        assert pixels(picture).shape[1::-1] == PLOT_PX
