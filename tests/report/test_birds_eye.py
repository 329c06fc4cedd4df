# SPDX-License-Identifier: MIT
import numpy as np
import pytest

from salsanext_cli.report.birds_eye import raster
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
