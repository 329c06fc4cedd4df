# SPDX-License-Identifier: MIT
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from salsanext_cli.records import RangeImage
from salsanext_cli.report.canvas import MARGIN_PX
from salsanext_cli.report.colours import EMPTY, map_colours
from salsanext_cli.report.panel import (
    BAR_PX,
    STRIP_HEIGHT_PX,
    STRIP_WIDTH_PX,
    TITLE_PX,
    Strip,
    panel,
    range_strip,
    scalar_strip,
)


def picture_of(path: Path) -> np.ndarray:
    return (imread(path)[:, :, :3] * 255).round().astype(np.uint8)


@pytest.fixture
def strip():
    rng = np.random.default_rng(5)
    return Strip("Höhe $x$_1", rng.integers(0, 256, (64, 2048, 3)).astype(np.uint8))


@pytest.mark.parametrize(("height", "width"), [(64, 2048), (32, 1024), (40, 1800), (128, 512)])
def test_every_pixel_is_drawn_as_it_is_upright_and_large(tmp_path, height, width):
    colours = np.random.default_rng(0).integers(0, 256, (height, width, 3)).astype(np.uint8)
    panel(tmp_path / "panel.png", [Strip("one", colours)])
    drawn = picture_of(tmp_path / "panel.png")
    down, across = round(STRIP_HEIGHT_PX / height), round(STRIP_WIDTH_PX / width)
    expected = colours.repeat(down, axis=0).repeat(across, axis=1)
    rows, columns = expected.shape[:2]
    assert rows >= 160
    assert columns >= 1800
    body = drawn[TITLE_PX : TITLE_PX + rows, MARGIN_PX : MARGIN_PX + columns]
    np.testing.assert_array_equal(body, expected)
    assert drawn.shape == (TITLE_PX + rows + MARGIN_PX, MARGIN_PX + columns + BAR_PX, 3)


def test_strips_are_below_each_other_with_bar_and_legend(tmp_path, strip):
    dark = Strip("dark", np.zeros((64, 2048, 3), np.uint8), (0, 80), "m")
    legend = [(f"class {i}", (250, i, 0)) for i in range(15)]
    panel(tmp_path / "panel.png", [strip, dark], legend)
    drawn = picture_of(tmp_path / "panel.png")
    second = drawn[2 * TITLE_PX + STRIP_HEIGHT_PX :][:STRIP_HEIGHT_PX]
    assert not second[:, MARGIN_PX : MARGIN_PX + 2048].any()
    bar = second[:, MARGIN_PX + 2048 + 16 + 8]
    np.testing.assert_array_equal(bar[[0, -1]], map_colours("viridis")[[255, 0]])
    colours = {tuple(pixel) for pixel in drawn[2 * (TITLE_PX + STRIP_HEIGHT_PX) :].reshape(-1, 3)}
    assert {colour for _, colour in legend} <= colours


def test_titles_are_written(tmp_path, strip):
    panel(tmp_path / "a.png", [strip])
    panel(tmp_path / "b.png", [Strip("", strip.picture)])
    panel(tmp_path / "c.png", [strip])
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "c.png").read_bytes()
    titled, bare = (picture_of(tmp_path / name)[:TITLE_PX] for name in ("a.png", "b.png"))
    assert len(np.unique(bare.reshape(-1, 3), axis=0)) == 1
    assert (titled != bare).any(axis=-1).sum() > 200


def test_strips_of_values_say_their_scale():
    point_of_pixel = np.arange(200, dtype=np.int32).reshape(2, 100)
    point_of_pixel[0, 0] = -1
    channels = np.zeros((5, 2, 100), np.float32)
    channels[0] = np.linspace(2, 40, 200).reshape(2, 100)
    image = RangeImage(
        channels, np.arange(200, dtype=np.int32), point_of_pixel, channels[0].ravel()
    )
    distance = range_strip(image)
    assert (distance.scale, distance.unit) == ((0, pytest.approx(39.6, abs=0.3)), "m")
    np.testing.assert_array_equal(distance.picture[1, 99], map_colours("viridis")[255])
    entropy = scalar_strip(image, "entropy", np.linspace(0, 1, 200))
    assert entropy.scale == pytest.approx((0.01, 0.99), abs=0.01)
    np.testing.assert_array_equal(entropy.picture[1, 99], map_colours("viridis")[255])
    np.testing.assert_array_equal(entropy.picture[0, 0], EMPTY)
