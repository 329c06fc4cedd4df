# SPDX-License-Identifier: MIT
"""The top view of a drive."""

import io

import numpy as np
import pytest
from matplotlib.image import imread

from salsanext_cli.report.canvas import MARGIN_PX
from salsanext_cli.report.drive_map import HEAD_PX, SIZE_PX, drive_map_picture, round_length

RED, GREEN = (255, 0, 0), (0, 255, 0)


def shares(png, colour):
    """Return where a colour is in the map, 0…1 from the top and from the left."""
    picture = (imread(io.BytesIO(png))[..., :3] * 255).round().astype(int)
    square = picture[HEAD_PX : HEAD_PX + SIZE_PX, MARGIN_PX : MARGIN_PX + SIZE_PX]
    rows, columns = np.nonzero((square == np.array(colour)).all(axis=-1))
    return rows / SIZE_PX, columns / SIZE_PX


def test_x_is_up_and_y_is_left_around_the_trajectory_far_from_the_origin():
    """Float32 would have steps of 8 m here."""
    origin = 1e8
    rng = np.random.default_rng(0)
    trajectory = np.array([[900.0, 500, 0], [1100, 500, 0]]) + origin
    points = rng.uniform(-1, 1, (2000, 3)) * (20, 20, 1)
    points[:1000] += (1080, 520, 0)
    points[1000:] += (920, 480, 0)
    points += origin
    colours = np.repeat(np.array([RED, GREEN], np.uint8), 1000, axis=0)
    png = drive_map_picture("drive", points, colours, trajectory, [])
    rows, columns = shares(png, RED)
    assert rows.max() < 0.3
    assert columns.max() < 0.52
    rows, columns = shares(png, GREEN)
    assert rows.min() > 0.7
    assert columns.min() > 0.48
    # Rounded coordinates would leave most rows without a point.
    assert len({*rows.tolist()}) > 100


@pytest.mark.parametrize(
    ("longest", "expected"), [(1, 1), (1.9, 1), (2, 2), (4.9, 2), (99, 50), (100, 100), (730, 500)]
)
def test_the_scale_has_a_round_length(longest, expected):
    assert round_length(longest) == expected
