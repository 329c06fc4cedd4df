# SPDX-License-Identifier: MIT
from io import BytesIO

import numpy as np
import pytest
from evaluated import small_space
from matplotlib.image import imread

from salsanext_cli.classes.label_space import label_space
from salsanext_cli.measures.confusion import Confusion
from salsanext_cli.measures.scores import scores
from salsanext_cli.report.colours import screen_colours
from salsanext_cli.report.plots import CELL_PX, NAMES_PX, ROW_PX, confusion_picture, iou_bars

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
