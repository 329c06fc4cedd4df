# SPDX-License-Identifier: MIT
"""Pictures of the documentation: the camera, colour bars, and the files."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from pictures import drive, example, keys, sheets
from pictures.rendering import BACKGROUND, Camera, rendered
from PIL import Image

from salsanext_cli import label_space
from salsanext_cli.core.records import RangeImage
from salsanext_cli.report.colours import FIXED_SCALES, screen_colours, value_colours

IMAGES = Path(__file__).parents[1] / "docs/images"
RED, BLUE = (255, 0, 0), (0, 0, 255)
ERRORS = FIXED_SCALES["error"]


def test_the_camera_sees_its_target_in_the_middle_and_turns_to_the_left():
    camera = Camera()
    right, up, depth = camera.seen(np.array([camera.target]))[0]
    assert (right, up) == pytest.approx((0, 0), abs=1e-9)
    assert depth == pytest.approx(np.linalg.norm(np.subtract(camera.target, camera.place)))
    assert camera.turned(90).target == pytest.approx((0, 7, -1))


def test_a_turned_camera_sees_turned_points_alike():
    rng = np.random.default_rng(0)
    points = rng.normal(0, 10, (50, 3))
    x, y, z = points.T
    turned = np.stack([-y, x, z], axis=1)
    assert Camera().turned(90).seen(turned) == pytest.approx(Camera().seen(points))


@pytest.mark.parametrize("nearer", [0, 1])
def test_near_points_cover_far_ones(nearer):
    camera = Camera()
    # Beside the middle, where rounding could move one of the points to the next pixel.
    way = np.subtract(camera.target, camera.place) - (0, 0.02, 0.02)
    points = camera.place + way * np.array([[1.0], [1.3]])
    colours = np.array([RED, BLUE], np.uint8)
    points = points if nearer == 0 else points[::-1]
    picture = np.asarray(rendered(points, colours, 60, 40, camera))
    # The picture is shrunk, so that the edges of a point mix with the background.
    red, _, blue = picture.reshape(-1, 3).max(axis=0)
    assert (red if nearer == 0 else blue) > 100
    assert (blue if nearer == 0 else red) <= max(BACKGROUND)


def test_a_scene_without_points_is_background():
    nothing = np.zeros((1, 3)) + 1000
    picture = np.asarray(rendered(nothing, np.array([RED], np.uint8), 8, 6, Camera()))
    assert (picture == BACKGROUND).all()


def test_the_colour_bar_of_the_animation_has_the_colour_of_each_mark_above_its_tick():
    bar = np.asarray(keys.colour_bar(ERRORS, [str(mark) for mark in ERRORS], 397))
    ticks = np.flatnonzero((bar[keys.MARGIN_PX + keys.SWATCH_PX + 1] == keys.INK).all(axis=1))
    left = ticks.reshape(len(ERRORS), -1)[:, 0]
    shown = bar[keys.MARGIN_PX + 2, left].astype(int)
    assert np.abs(shown - value_colours(np.array(ERRORS), *ERRORS)).max() <= 8


def test_the_colour_bar_of_a_figure_has_a_named_tick_at_each_mark():
    axis = Figure().subplots()
    marks = (0.0, 1e-5, 1e-4, 0.01, 0.5)
    sheets.colour_bar(axis, marks)
    names = [label.get_text() for label in axis.get_xticklabels()]
    assert names == ["0", "$10^{-5}$", "$10^{-4}$", "0.01", "0.5"]
    (strip,) = axis.get_images()
    cells = strip.get_array().shape[1]
    places = np.rint(np.linspace(0, cells - 1, len(marks))).astype(int)
    expected = value_colours(np.array(marks), *marks).astype(int)
    assert np.abs(strip.get_array()[0, places].astype(int) - expected).max() <= 4


def test_the_animation_contains_the_exact_colours_of_the_classes():
    colours = screen_colours(label_space())
    classes = Image.fromarray(colours[None]).quantize(
        palette=drive.palette(), dither=Image.Dither.NONE
    )
    assert (np.asarray(classes.convert("RGB"))[0] == colours)[1:].all()


def test_distances_behind_the_nearest_point_are_those_of_a_loop():
    rng = np.random.default_rng(0)
    pixels = rng.integers(-1, 6, 40)
    ranges = rng.uniform(1, 50, 40).astype(np.float32)
    channels = np.zeros((5, 2, 3), np.float32)
    expected = np.zeros(40)
    for pixel in range(6):
        inside = np.flatnonzero(pixels == pixel)
        channels[0].flat[pixel] = min(ranges[inside], default=0)
        for point in inside:
            expected[point] = ranges[point] - min(ranges[inside])
    image = RangeImage(channels, pixels, np.full((2, 3), -1), ranges)
    assert example.behind(image) == pytest.approx(expected)


def test_the_animation_is_small_and_moves():
    assert (IMAGES / "demo.gif").stat().st_size < 3e6
    with Image.open(IMAGES / "demo.gif") as animation:
        assert animation.n_frames >= 30
        assert animation.width <= 800
