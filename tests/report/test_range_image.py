# SPDX-License-Identifier: MIT
import numpy as np
import pytest

from salsanext_cli.classes import label_space
from salsanext_cli.records import RangeImage
from salsanext_cli.report.colours import EMPTY, RIGHT, WRONG, map_colours
from salsanext_cli.report.range_image import (
    error_picture,
    label_picture,
    on_pixels,
    scalar_picture,
)

SPACE = label_space()


@pytest.fixture
def image():
    """Two rows, three columns: point 0 upper left, point 2 hides point 1 lower right."""
    point_of_pixel = np.array([[0, -1, -1], [-1, -1, 2]], np.int32)
    channels = np.zeros((5, 2, 3), np.float32)
    channels[0, 0, 0], channels[0, 1, 2] = 5, 10
    pixel_of_point = np.array([0, 5, 5, -1], np.int32)
    point_range = np.array([5, 11, 10, 0], np.float32)
    return RangeImage(channels, pixel_of_point, point_of_pixel, point_range)


def test_pixels_get_what_belongs_to_the_point_they_show(image):
    of_points = np.array([7, 8, 9, 6], np.uint8)
    np.testing.assert_array_equal(on_pixels(image, of_points), [[7, 0, 0], [0, 0, 9]])
    assert on_pixels(image, np.ones((4, 2))).shape == (2, 3, 2)


def test_labels_are_drawn_the_first_point_too(image):
    picture = label_picture(image, np.array([1, 2, 0, 3], np.uint8), SPACE)
    np.testing.assert_array_equal(picture[0, 0], SPACE.colours[1])
    # Unlabelled is a colour of the label space; empty is not.
    np.testing.assert_array_equal(picture[1, 2], SPACE.colours[0])
    np.testing.assert_array_equal(picture[0, 1], EMPTY)


def test_errors_are_drawn(image):
    picture = error_picture(image, np.array([1, 1, 1, 1]), np.array([1, 1, 2, 1]), SPACE)
    np.testing.assert_array_equal(picture[0, 0], RIGHT)
    np.testing.assert_array_equal(picture[1, 2], WRONG)
    np.testing.assert_array_equal(picture[1, 1], EMPTY)


def test_values_are_drawn(image):
    of_pixels = scalar_picture(image, image.channels[0], 5, 10)
    np.testing.assert_array_equal(of_pixels[0, 0], map_colours("viridis")[0])
    np.testing.assert_array_equal(of_pixels[1, 2], map_colours("viridis")[255])
    np.testing.assert_array_equal(of_pixels[0, 2], EMPTY)
