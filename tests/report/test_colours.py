# SPDX-License-Identifier: MIT
import matplotlib
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from salsanext_cli.classes import label_space
from salsanext_cli.report.colours import (
    EMPTY,
    LEAST_LUMA,
    LUMA,
    RIGHT,
    WRONG,
    error_colours,
    legend_of,
    on_dark,
    value_colours,
    value_range,
)

SPACE = label_space()
CAR, ROAD = SPACE.names.index("car"), SPACE.names.index("road")


def test_errors_are_right_wrong_or_of_ignored_truth():
    colours = error_colours(np.array([CAR, CAR, CAR, 0]), np.array([CAR, ROAD, 0, CAR]), SPACE)
    np.testing.assert_array_equal(colours, [RIGHT, WRONG, WRONG, EMPTY])


def test_values_have_the_colours_of_the_map():
    colours = value_colours(np.array([-9.0, 1.0, 2.0, 3.0, np.inf, np.nan]), 1.0, 3.0)
    viridis = matplotlib.colormaps["viridis"]
    expected = [viridis(place, bytes=True)[:3] for place in (0, 0, 128, 255, 255)]
    np.testing.assert_array_equal(colours, [*expected, EMPTY])
    assert value_colours(np.array([2.0, 2.0]), 2.0, 2.0).shape == (2, 3)


@given(arrays(np.float32, (3, 4), elements=st.floats(width=32)))
def test_any_value_has_a_colour(values):
    low, high = value_range(values)
    colours = value_colours(values, low, high)
    assert colours.shape == (3, 4, 3)
    assert (np.isnan(values) == (colours == EMPTY).all(axis=-1)).all()


def test_a_scale_leaves_outliers_out():
    values = np.append(np.linspace(0, 1, 1000), [1e9, np.nan, np.inf])
    low, high = value_range(values)
    assert 0 < low < 0.02
    assert 0.98 < high < 1


@pytest.mark.parametrize("values", [[], [np.nan], [np.inf, -np.inf]], ids=str)
def test_a_scale_of_nothing(values):
    assert value_range(np.array(values)) == (0, 1)


def test_a_legend_names_what_occurs_once():
    legend = legend_of(SPACE, np.array([ROAD, CAR]), np.array([[CAR]]), errors=True)
    assert legend == [
        ("car", (100, 150, 245)),
        ("road", (255, 0, 255)),
        ("right", RIGHT),
        ("wrong", WRONG),
    ]
    assert legend_of(SPACE, np.array([CAR])) == legend[:1]


def test_on_dark_every_class_can_be_seen_and_bright_ones_stay():
    before, after = SPACE.colours, on_dark(SPACE.colours)
    assert (after @ LUMA >= LEAST_LUMA - 0.5).all()
    bright = before @ LUMA >= LEAST_LUMA
    assert np.array_equal(after[bright], before[bright])
    road, sidewalk = (after[SPACE.names.index(name)] for name in ("road", "sidewalk"))
    assert np.abs(road.astype(int) - sidewalk).max() > 100


@given(arrays(np.uint8, (5, 3)))
def test_lightening_never_darkens_and_keeps_the_order_of_channels(colours):
    after = on_dark(colours)
    assert (after >= colours).all()
    assert (np.diff(after.astype(int)) * np.diff(colours.astype(int)) >= 0).all()
