# SPDX-License-Identifier: MIT
import sys

import numpy as np
import pytest
from matplotlib.image import imread

from salsanext_cli.classes import LabelSpace, label_space
from salsanext_cli.measures.confusion import Confusion
from salsanext_cli.measures.scores import scores
from salsanext_cli.report import plots
from salsanext_cli.report.plots import CELL, NAMES, ROW, confusion_picture, iou_bars

SPACE = label_space()


def counts() -> Confusion:
    """Every car found, half the road called unlabelled, everything else absent."""
    car, road = SPACE.names.index("car"), SPACE.names.index("road")
    return Confusion(SPACE.class_count).update(
        np.array([car, car, road, road, 0]), np.array([car, car, road, 0, car])
    )


def pixels(path):
    return (imread(path)[:, :, :3] * 255).round().astype(int)


def test_bars_are_as_long_as_the_iou_in_the_colour_of_the_class(tmp_path):
    iou_bars(tmp_path / "iou.png", scores(counts(), SPACE), SPACE)
    picture = pixels(tmp_path / "iou.png")
    lengths = {}
    for name in ("car", "road", "person"):
        place = SPACE.names.index(name) - 1
        row = picture[70 + place * ROW + ROW // 2 - 7]
        colour = SPACE.colours[SPACE.names.index(name)]
        lengths[name] = (row == colour).all(axis=-1).sum() / (690 / 1.08)
    assert lengths["car"] == pytest.approx(1, abs=0.02)
    assert lengths["road"] == pytest.approx(0.5, abs=0.02)
    assert lengths["person"] == 0


def test_cells_are_as_dark_as_the_share_of_the_row(tmp_path):
    confusion_picture(tmp_path / "confusion.png", counts(), SPACE)
    picture = pixels(tmp_path / "confusion.png")
    car, road = SPACE.names.index("car"), SPACE.names.index("road")

    def cell(truth, predicted):
        return picture[30 + (truth - 1) * CELL + 5, NAMES + predicted * CELL + 5].sum()

    assert cell(car, car) < cell(road, road) < cell(car, road)
    # The row of an absent class is grey from end to end.
    grey = picture[30 + 5 * CELL + 5, NAMES + 5]
    assert grey.max() - grey.min() < 10
    assert cell(6, 3) == cell(6, 6) < cell(car, road)


def test_nothing_to_draw_is_drawn(tmp_path):
    nothing = Confusion(SPACE.class_count)
    iou_bars(tmp_path / "iou.png", scores(nothing, SPACE), SPACE)
    confusion_picture(tmp_path / "confusion.png", nothing, SPACE)
    assert {path.suffix for path in tmp_path.iterdir()} == {".png"}


def test_names_may_hold_anything(tmp_path):
    space = LabelSpace.from_dict(
        {
            "labels": {0: "none", 1: "$\\frac{$ [b]", 2: "Straße"},
            "learning_map": {0: 0, 1: 1, 2: 2},
            "learning_map_inv": {0: 0, 1: 1, 2: 2},
        }
    )
    confusion = Confusion(3).update(np.array([1, 2]), np.array([1, 1]))
    iou_bars(tmp_path / "iou.png", scores(confusion, space), space)
    confusion_picture(tmp_path / "confusion.png", confusion, space)


def test_drawing_leaves_no_state_behind(tmp_path):
    iou_bars(tmp_path / "iou.png", scores(counts(), SPACE), SPACE)
    assert (
        "matplotlib.pyplot" not in sys.modules or not sys.modules["matplotlib.pyplot"].get_fignums()
    )
    assert not hasattr(plots, "matplotlib")
