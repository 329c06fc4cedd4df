# SPDX-License-Identifier: MIT
from io import BytesIO

import numpy as np
import pytest
from evaluated import calibration_result, ranking_result, small_space
from matplotlib.image import imread

from salsanext_cli.classes.label_space import label_space
from salsanext_cli.measures.scores import Confusion, scores
from salsanext_cli.report.colours import screen_colours
from salsanext_cli.report.plots import (
    CELL_PX,
    HEIGHT_ABOVE,
    LEFT,
    NAMES_PX,
    PLOT_PX,
    ROW_PX,
    SKY,
    TOP,
    WIDTH,
    class_uncertainty,
    confusion_picture,
    error_diagram,
    iou_bars,
    reliability_diagram,
    risk_coverage,
    sparsification,
)

SPACE = label_space()


def counts() -> Confusion:
    """Every car found, half the road called unlabelled, everything else absent."""
    car, road = SPACE.names.index("car"), SPACE.names.index("road")
    return Confusion(SPACE.class_count).update(
        np.array([car, car, road, road, 0]), np.array([car, car, road, 0, car])
    )


def pixels(png: bytes) -> np.ndarray:
    return (imread(BytesIO(png))[:, :, :3] * 255).round().astype(int)


def test_bars_are_as_long_as_the_iou_in_the_colour_of_the_class():
    picture = pixels(iou_bars(scores(counts(), SPACE), SPACE))
    lengths = {}
    for name in ("car", "road", "person"):
        place = SPACE.names.index(name) - 1
        row = picture[70 + place * ROW_PX + ROW_PX // 2 - 7]
        colour = screen_colours(SPACE)[SPACE.names.index(name)]
        lengths[name] = (row == colour).all(axis=-1).sum() / (690 / 1.08)
    assert lengths["car"] == pytest.approx(1, abs=0.02)
    assert lengths["road"] == pytest.approx(0.5, abs=0.02)
    assert lengths["person"] == 0


def test_cells_are_as_dark_as_the_share_of_the_row():
    picture = pixels(confusion_picture(counts(), SPACE))
    car, road = SPACE.names.index("car"), SPACE.names.index("road")

    def cell(truth, predicted):
        return picture[30 + (truth - 1) * CELL_PX + 5, NAMES_PX + predicted * CELL_PX + 5].sum()

    assert cell(car, car) < cell(road, road) < cell(car, road)
    # The row of an absent class is grey from end to end.
    grey = picture[30 + 5 * CELL_PX + 5, NAMES_PX + 5]
    assert grey.max() - grey.min() < 10
    assert cell(6, 3) == cell(6, 6) < cell(car, road)


def test_without_points_and_with_any_names_there_is_a_picture():
    space = small_space("none", "$\\frac{$ [b]", "Straße")
    for confusion in (Confusion(3), Confusion(3).update(np.array([1, 2]), np.array([1, 1]))):
        assert pixels(iou_bars(scores(confusion, space), space)).size
        assert pixels(confusion_picture(confusion, space)).size


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
        error_diagram(result, SPACE),
    ):
        assert pixels(picture).shape[1::-1] == PLOT_PX
