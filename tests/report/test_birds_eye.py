# SPDX-License-Identifier: MIT
import numpy as np
import pytest
from matplotlib.image import imread

from salsanext_cli.report.birds_eye import TITLE_PX, VIEW_PX, birds_eye, raster
from salsanext_cli.report.canvas import MARGIN_PX
from salsanext_cli.report.colours import EMPTY

RED, GREEN = (255, 0, 0), (0, 255, 0)


def seen(points, colours, **how):
    return raster(
        np.array(points, np.float32), np.array(colours, np.uint8), reach=10, size=20, **how
    )


@pytest.mark.parametrize(
    ("point", "row", "column"),
    [
        ((9.5, 0.5, 0), 0, 9),
        ((-9.5, 0.5, 0), 19, 9),
        ((0.5, 9.5, 0), 9, 0),
        ((0.5, -9.5, 0), 9, 19),
    ],
)
def test_forward_is_up_and_left_is_left(point, row, column):
    picture = seen([point], [RED])
    assert np.argwhere((picture == RED).all(axis=-1)).tolist() == [[row, column]]
    assert ((picture == EMPTY).all(axis=-1)).sum() == 399


@pytest.mark.parametrize("spread", [1, 2, 3])
def test_a_higher_point_hides_a_lower_one(spread):
    points = [(0.5, 0.5, 2), (0.5, 0.5, -1), (0.5, 0.5, 1)]
    picture = seen(points, [RED, GREEN, GREEN], spread=spread)
    assert (picture == RED).all(axis=-1).sum() == spread**2
    assert not (picture == GREEN).all(axis=-1).any()


@pytest.mark.parametrize("point", [(np.nan, 0, 0), (np.inf, 0, 0), (10.01, 0, 0), (0, -1e9, 0)])
def test_points_outside_the_view_are_left_out(point):
    assert (seen([point], [RED]) == EMPTY).all()
    assert (seen(np.zeros((0, 3)), np.zeros((0, 3))) == EMPTY).all()


def test_large_points_are_cut_at_the_edge_not_wrapped():
    picture = seen([(-9.9, -9.9, 0), (10.4, 10.4, 0)], [RED, GREEN], spread=3)
    red, green = (np.argwhere((picture == c).all(axis=-1)) for c in (RED, GREEN))
    assert red.tolist() == [[19, 19]]
    assert green.tolist() == [[0, 0], [0, 1], [1, 0], [1, 1]]


def test_views_are_side_by_side(tmp_path):
    rng = np.random.default_rng(3)
    points = rng.uniform(-40, 40, (5000, 3)).astype(np.float32)
    points[:, 0] = abs(points[:, 0])
    colours = {"truth": RED, "prediction": GREEN}
    views = {title: np.full((5000, 3), colour, np.uint8) for title, colour in colours.items()}
    path = tmp_path / "birds eye.png"
    birds_eye(path, points, views, [("car", (1, 2, 250))])
    drawn = (imread(path)[:, :, :3] * 255).round().astype(np.uint8)
    assert drawn.shape[1] == 2 * VIEW_PX + 3 * MARGIN_PX
    starts = (MARGIN_PX, 2 * MARGIN_PX + VIEW_PX)
    body = drawn[TITLE_PX : TITLE_PX + VIEW_PX].astype(int)
    for start, own, other in zip(starts, (0, 1), (1, 0), strict=True):
        view = body[:, start : start + VIEW_PX]
        coloured = view[..., own] - view[..., other] > 100
        assert coloured[: VIEW_PX // 2].sum() > 5000
        assert not coloured[VIEW_PX // 2 + 5 :].any()
        assert not (view[..., other] - view[..., own] > 100).any()
    assert (drawn[TITLE_PX + VIEW_PX :] == (1, 2, 250)).all(axis=-1).any()
