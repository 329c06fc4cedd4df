# SPDX-License-Identifier: MIT
import itertools
from io import BytesIO

import numpy as np
import pytest
from evaluated import SPACE, calibration_result, ranking_result
from matplotlib.image import imread

from salsanext_cli.report import canvas
from salsanext_cli.report.uncertainty_plots import (
    HEIGHT_ABOVE,
    LEFT,
    PLOT_PX,
    SKY,
    TOP,
    WIDTH,
    class_uncertainty,
    name_dots,
    reliability_diagram,
    risk_coverage,
    sparsification,
)


def pixels(png: bytes) -> np.ndarray:
    return (imread(BytesIO(png))[:, :, :3] * 255).round().astype(int)


def rgb(colour: str) -> list[int]:
    return [int(colour[i : i + 2], 16) for i in (1, 3, 5)]


def rows_of(picture, colour, x) -> np.ndarray:
    """Return how high a colour reaches in a column of the axes: 0 at the bottom, 1 at the top."""
    column = picture[TOP : TOP + HEIGHT_ABOVE + 1, LEFT + round(x * WIDTH)]
    near = np.abs(column - rgb(colour)).sum(axis=-1) < 60
    return 1 - np.flatnonzero(near) / HEIGHT_ABOVE


def test_bars_are_as_high_as_the_accuracy():
    picture = pixels(reliability_diagram(calibration_result([1] * 6 + [2] * 4)))
    assert rows_of(picture, SKY, 11.5 / 15).max() == pytest.approx(0.6, abs=0.01)
    assert not rows_of(picture, SKY, 5.5 / 15).size


@pytest.mark.parametrize("count", [0, 2])
def test_pictures_are_of_one_size_with_wrong_points_or_without(count):
    result = ranking_result([0.1] * count, np.zeros(count, bool))
    for picture in (
        risk_coverage({"epistemic": result}),
        sparsification({"epistemic": result}),
        class_uncertainty(result, SPACE),
        reliability_diagram(calibration_result([])),
    ):
        assert pixels(picture).shape[1::-1] == PLOT_PX


def drawn_names(x, y, names):
    """Return the axes and the boxes of the names beside dots."""
    figure = canvas.new_figure(800, 500, canvas.PAPER)
    axes = canvas.axes_at(figure, 50, 50, 700, 400)
    axes.set_xlim(0, 1)
    axes.set_ylim(0, 1)
    name_dots(axes, np.array(x), np.array(y), names, "black")
    return axes, [text.get_window_extent() for text in axes.texts]


def test_names_do_not_cover_each_other_nor_the_dots():
    rng = np.random.default_rng(0)
    x, y = rng.uniform(0.4, 0.7, (2, 19))
    axes, boxes = drawn_names(x, y, SPACE.names[1:])
    assert not any(a.overlaps(b) for a, b in itertools.combinations(boxes, 2))
    for dot in axes.transData.transform(np.stack([x, y], axis=1)):
        assert not any(box.contains(*dot) for box in boxes)
    # Those without room at their dot have a line to it; none leaves the axes.
    assert axes.lines
    assert all(axes.bbox.contains(*corner) for box in boxes for corner in (box.min, box.max))
    assert not drawn_names([0.0, 1.0], [1.0, 0.0], ["left", "right $x$"])[0].lines
