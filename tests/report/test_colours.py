# SPDX-License-Identifier: MIT
"""Colours, and the plots that use them."""

from dataclasses import replace
from itertools import combinations

import matplotlib
import numpy as np
import pytest
from class_colours import CAR, ROAD, SPACE
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from salsanext_cli.io.label_spaces import label_space
from salsanext_cli.report.colours import (
    EMPTY,
    MIN_CONTRAST,
    legend_of,
    map_colours,
    map_on_dark,
    on_dark,
    screen_colours,
    value_colours,
)


def test_values_have_the_colours_of_the_map_by_equal_steps_between_marks():
    values = np.array([-9.0, 1.0, 2.0, 3.0, np.inf, np.nan])
    colours = value_colours(values, 1.0, 3.0, colour_map=map_colours("viridis"))
    viridis = matplotlib.colormaps["viridis"]
    expected = [viridis(place, bytes=True)[:3] for place in (0, 0, 128, 255, 255)]
    np.testing.assert_array_equal(colours, [*expected, EMPTY])
    in_pictures = [*on_dark(expected), EMPTY]
    np.testing.assert_array_equal(value_colours(values, 1.0, 3.0), in_pictures)
    assert value_colours(np.array([2.0, 2.0]), 2.0, 2.0).shape == (2, 3)
    values = np.array([0.01, 0.02, 0.35, 1.0, 9.0, np.nan])
    colours = value_colours(values, 0.0, 0.02, 0.2, 0.5, 1.0, 2.0, 3.0)
    steps = np.rint(np.array([0.5, 1, 2.5, 4, 6]) / 6 * 255).astype(int)
    np.testing.assert_array_equal(colours, [*map_on_dark()[steps], EMPTY])


def test_a_legend_names_each_class_once():
    legend = legend_of(SPACE, np.array([ROAD, CAR]), np.array([[CAR]]))
    car, road = (tuple(screen_colours(SPACE)[i].tolist()) for i in (CAR, ROAD))
    assert legend == [("car", car), ("road", road)]
    assert legend_of(SPACE, np.array([CAR])) == legend[:1]
    ((_, sidewalk),) = legend_of(SPACE, np.array([SPACE.names.index("sidewalk")]))
    assert contrast(sidewalk) >= MIN_CONTRAST > 2 * contrast((75, 0, 75))


def contrast(colour):
    """Return the contrast ratio of WCAG 2 of a colour with the background, one value at a time."""

    def luminance(rgb):
        light = 0.0
        for value, weight in zip(rgb, (0.2126, 0.7152, 0.0722), strict=True):
            share = value / 255
            linear = share / 12.92 if share <= 0.04045 else ((share + 0.055) / 1.055) ** 2.4
            light += weight * linear
        return light + 0.05

    return luminance(colour) / luminance(EMPTY)


@given(arrays(np.uint8, (5, 3)))
def test_dark_colours_are_mixed_with_just_enough_white(colours):
    for colour, seen in zip(colours.tolist(), on_dark(colours).tolist(), strict=True):
        assert contrast(seen) >= MIN_CONTRAST
        if contrast(colour) >= MIN_CONTRAST:
            assert seen == colour
        else:
            assert contrast(seen) < MIN_CONTRAST + 0.1
            # The order of red, green and blue stays.
            assert all(seen[i] >= seen[j] for i in range(3) for j in range(3)
                       if colour[i] >= colour[j])  # fmt: skip


def screen_of(colours):
    """Return the colours on screens of a label space with these colours."""
    return screen_colours(replace(SPACE, colours=np.array(colours, np.uint8)))


@pytest.mark.parametrize("name", ["coarse", "semantic-kitti"])
def test_classes_differ_clearly_in_pictures(name):
    space = label_space(name)
    colours = dict(zip(space.names, screen_colours(space).astype(int), strict=True))
    for first, second in combinations(colours.values(), 2):
        assert np.linalg.norm(first - second) > 40
    assert all(contrast(colour) >= MIN_CONTRAST for colour in colours.values())
    assert np.ptp(colours["unlabeled"]) == 0
    # The familiar colours of SemanticKITTI hardly change.
    original = dict(zip(space.names, space.colours.astype(int), strict=True))
    for name in {"car", "road", "building", "vegetation", "terrain", "person"} & {*original}:
        assert np.linalg.norm(colours[name] - original[name]) < 25


def test_classes_of_one_colour_get_others_and_those_of_another_label_space_stay():
    colours = screen_of(np.zeros((17, 3))).astype(int)
    assert len(colours) == 17
    for first, second in combinations(colours, 2):
        assert np.linalg.norm(first - second) > 30
    # Only classes of SemanticKITTI get its colours for dark backgrounds.
    person_and_car = SPACE.colours[[SPACE.names.index("person"), CAR]]
    renamed = {i: f"other {name}" for i, name in SPACE.labels.items()}
    colours = screen_colours(replace(SPACE, labels=renamed, colours=person_and_car))
    np.testing.assert_array_equal(colours, on_dark(person_and_car))


@given(st.integers(1, 255).flatmap(lambda n: arrays(np.uint8, (n, 3))))
def test_any_classes_have_different_visible_colours(given_colours):
    colours = screen_of(given_colours)
    assert len(np.unique(colours, axis=0)) == len(given_colours)
    assert all(contrast(colour) >= MIN_CONTRAST for colour in colours)
    np.testing.assert_array_equal(colours, screen_of(given_colours))
