# SPDX-License-Identifier: MIT
import io

import numpy as np
import pytest
from matplotlib.image import imread

from salsanext_cli.records import RangeImage
from salsanext_cli.report import canvas
from salsanext_cli.report.canvas import MARGIN_PX
from salsanext_cli.report.colours import EMPTY, map_on_dark
from salsanext_cli.report.panel import (
    BAR_PX,
    STRIP_HEIGHT_PX,
    TITLE_PX,
    Strip,
    draw_strips,
    range_strip,
)

WIDTH, TOP = 2048, 30
ROW = TITLE_PX + STRIP_HEIGHT_PX


def drawn(*strips: Strip) -> np.ndarray:
    figure = canvas.new_figure(MARGIN_PX + WIDTH + BAR_PX, TOP + len(strips) * ROW)
    draw_strips(figure, strips, TOP, WIDTH)
    picture = imread(io.BytesIO(canvas.png_of(figure)))
    return (picture[:, :, :3] * 255).round().astype(np.uint8)


def noise(height: int, width: int) -> np.ndarray:
    return np.random.default_rng(5).integers(0, 256, (height, width, 3)).astype(np.uint8)


@pytest.mark.parametrize(("height", "width"), [(64, 2048), (32, 1024), (128, 512)])
def test_every_pixel_is_drawn_as_it_is_upright_and_large(height, width):
    colours = noise(height, width)
    body = drawn(Strip("one", colours))[TOP + TITLE_PX :, MARGIN_PX : MARGIN_PX + WIDTH]
    expected = colours.repeat(STRIP_HEIGHT_PX // height, axis=0).repeat(WIDTH // width, axis=1)
    np.testing.assert_array_equal(body, expected)


def test_the_strip_of_distances_says_its_scale():
    point_of_pixel = np.arange(200, dtype=np.int32).reshape(2, 100)
    point_of_pixel[0, 0] = -1
    channels = np.zeros((5, 2, 100), np.float32)
    channels[0] = np.linspace(2, 40, 200).reshape(2, 100)
    image = RangeImage(
        channels, np.arange(200, dtype=np.int32), point_of_pixel, channels[0].ravel()
    )
    distance = range_strip(image)
    assert (distance.scale, distance.unit) == ((0, pytest.approx(39.6, abs=0.3)), "m")
    np.testing.assert_array_equal(distance.picture[1, 99], map_on_dark()[255])
    np.testing.assert_array_equal(distance.picture[0, 0], EMPTY)
