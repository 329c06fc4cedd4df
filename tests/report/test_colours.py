# SPDX-License-Identifier: MIT
from dataclasses import replace

import matplotlib
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from salsanext_cli.classes.label_space import label_space
from salsanext_cli.report.colours import (
    EMPTY,
    MIN_CONTRAST,
    MIN_DIFFERENCE,
    colour_difference,
    legend_of,
    map_colours,
    map_on_dark,
    on_dark,
    screen_colours,
    value_colours,
    value_range,
)

SPACE = label_space()
CAR, ROAD = SPACE.names.index("car"), SPACE.names.index("road")


def test_values_have_the_colours_of_the_map():
    values = np.array([-9.0, 1.0, 2.0, 3.0, np.inf, np.nan])
    colours = value_colours(values, 1.0, 3.0, colour_map=map_colours("viridis"))
    viridis = matplotlib.colormaps["viridis"]
    expected = [viridis(place, bytes=True)[:3] for place in (0, 0, 128, 255, 255)]
    np.testing.assert_array_equal(colours, [*expected, EMPTY])
    in_pictures = [*on_dark(expected), EMPTY]
    np.testing.assert_array_equal(value_colours(values, 1.0, 3.0), in_pictures)
    assert value_colours(np.array([2.0, 2.0]), 2.0, 2.0).shape == (2, 3)


def test_marks_of_a_scale_are_at_equal_steps_of_the_map():
    values = np.array([0.01, 0.02, 0.35, 1.0, 9.0, np.nan])
    colours = value_colours(values, 0.0, 0.02, 0.2, 0.5, 1.0, 2.0, 3.0)
    steps = np.rint(np.array([0.5, 1, 2.5, 4, 6]) / 6 * 255).astype(int)
    np.testing.assert_array_equal(colours, [*map_on_dark()[steps], EMPTY])


@given(arrays(np.float32, (3, 4), elements=st.floats(width=32)))
def test_any_value_has_a_colour(values):
    low, high = value_range(values)
    colours = value_colours(values, low, high)
    assert colours.shape == (3, 4, 3)
    assert (np.isnan(values) == (colours == EMPTY).all(axis=-1)).all()


def test_a_legend_names_what_occurs_once():
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
def test_dark_colours_are_mixed_with_as_little_white_as_makes_them_visible(colours):
    for colour, seen in zip(colours.tolist(), on_dark(colours).tolist(), strict=True):
        assert contrast(seen) >= MIN_CONTRAST
        if contrast(colour) >= MIN_CONTRAST:
            assert seen == colour
        else:
            assert contrast(seen) < MIN_CONTRAST + 0.1
            # Hues stay: what was the largest part still is.
            assert all(seen[i] >= seen[j] for i in range(3) for j in range(3)
                       if colour[i] >= colour[j])  # fmt: skip


def apart(colours):
    """Return the least difference of two of some colours."""
    table = colour_difference(colours[:, None], colours[None])
    return table[~np.eye(len(table), dtype=bool)].min()


def screen_of(colours):
    """Return the colours on screens of a label space with these colours."""
    return screen_colours(replace(SPACE, colours=np.array(colours, np.uint8)))


@pytest.mark.parametrize("name", ["coarse", "semantic-kitti"])
def test_classes_can_be_told_apart_in_pictures(name):
    space = label_space(name)
    colours = dict(zip(space.names, screen_colours(space), strict=True))
    assert apart(np.array([*colours.values()])) >= MIN_DIFFERENCE
    assert all(contrast(colour) >= MIN_CONTRAST for colour in colours.values())
    assert np.ptp(colours["unlabeled"]) == 0
    # Those known from SemanticKITTI's are hardly changed.
    own = dict(zip(space.names, space.colours, strict=True))
    for name in {"car", "road", "building", "vegetation", "terrain", "person"} & {*own}:
        assert colour_difference(colours[name], own[name]) < 5


@given(st.integers(1, 32).flatmap(lambda n: arrays(np.uint8, (n, 3))))
def test_up_to_32_classes_of_any_colours_can_be_told_apart(own):
    colours = screen_of(own)
    assert len(own) == 1 or apart(colours) >= MIN_DIFFERENCE
    assert all(contrast(colour) >= MIN_CONTRAST for colour in colours)
    np.testing.assert_array_equal(colours, screen_of(own))


def test_many_classes_differ_as_much_as_they_can():
    assert apart(screen_of(np.zeros((43, 3)))) > 10
    assert len(np.unique(screen_of(np.zeros((255, 3))), axis=0)) == 255
