# SPDX-License-Identifier: MIT
"""Colours, and the plots that use them."""

from dataclasses import replace
from io import BytesIO
from itertools import combinations

import matplotlib
import numpy as np
import pytest
from evaluated import calibration_result, ranking_result, small_space
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from matplotlib.image import imread

from salsanext_cli.core.measures.scores import Counts, confusion_matrix
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
from salsanext_cli.report.plots import (
    CELL_PX,
    HEIGHT,
    LEFT,
    NAMES_PX,
    PLOT_PX,
    SKY,
    TOP,
    WIDTH,
    confusion_picture,
    reliability_diagram,
    risk_coverage,
)

SPACE = label_space()
CAR, ROAD = SPACE.names.index("car"), SPACE.names.index("road")


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


def counts() -> Counts:
    """Every car right, half of the road unlabelled, all other classes absent."""
    truth, predicted = np.array([[CAR, CAR, ROAD, ROAD, 0], [CAR, CAR, ROAD, 0, CAR]])
    return confusion_matrix(truth, predicted, SPACE.class_count)


def pixels(png: bytes) -> np.ndarray:
    return (imread(BytesIO(png))[:, :, :3] * 255).round().astype(int)


def test_cells_are_as_dark_as_the_share_of_the_row_with_any_points_and_names():
    picture = pixels(confusion_picture(counts(), SPACE))

    def cell(truth, predicted):
        row, column = 30 + (truth - 1) * CELL_PX, NAMES_PX + predicted * CELL_PX
        return picture[row + 5, column + 5].sum()

    assert cell(CAR, CAR) < cell(ROAD, ROAD) < cell(CAR, ROAD)
    # The row of an absent class is grey from end to end.
    grey = picture[30 + 5 * CELL_PX + 5, NAMES_PX + 5]
    assert grey.max() - grey.min() < 10
    assert cell(6, 3) == cell(6, 6) < cell(CAR, ROAD)
    space = small_space("none", "$\\frac{$ [b]", "Straße")
    some = confusion_matrix(np.array([1, 2]), np.array([1, 1]), 3)
    for confusion in (np.zeros_like(some), some):
        assert pixels(confusion_picture(confusion, space)).size


def rgb(colour: str) -> list[int]:
    return [int(colour[i : i + 2], 16) for i in (1, 3, 5)]


def rows_of(picture, colour, x) -> np.ndarray:
    """Return how high a colour reaches in a column of the axes: 0 at the bottom, 1 at the top."""
    column = picture[TOP : TOP + HEIGHT + 1, LEFT + round(x * WIDTH)]
    near = np.abs(column - rgb(colour)).sum(axis=-1) < 60
    return 1 - np.flatnonzero(near) / HEIGHT


def test_bars_are_as_high_as_the_accuracy():
    result = calibration_result([1] * 6 + [2] * 4).reliability
    picture = pixels(reliability_diagram(result, "softmax", "confidence", "accuracy"))
    assert rows_of(picture, SKY, 11.5 / 15).max() == pytest.approx(0.6, abs=0.01)
    assert not rows_of(picture, SKY, 5.5 / 15).size


@pytest.mark.parametrize("count", [0, 2])
def test_plots_have_one_size_with_and_without_points(count):
    result = ranking_result([0.1] * count, np.zeros(count, bool))
    for picture in (
        risk_coverage({"epistemic": result}),
        reliability_diagram(
            calibration_result([]).reliability, "softmax", "confidence", "accuracy"
        ),
    ):
        assert pixels(picture).shape[1::-1] == PLOT_PX
