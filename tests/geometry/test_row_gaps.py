# SPDX-License-Identifier: MIT
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scans import SMALL

from salsanext_cli.geometry.network_input import (
    FILLED_ROWS,
    MAX_GAP,
    fill_rows,
    fills_rows,
    row_gaps,
    with_filled_gaps,
)


def image(share, height=24, width=30, seed=0):
    """Return a range image with a share of its pixels occupied."""
    random = np.random.default_rng(seed)
    channels = random.uniform(0.5, 9, (5, height, width)).astype(np.float32)
    return channels * (random.random((height, width)) < share)


def column_gaps(ranges):
    """Return the places in gaps of one column, pixel by pixel."""
    full = [row for row, distance in enumerate(ranges) if distance > 0]
    return [
        row
        for above, below in pairwise(full)
        for row in range(above + 1, below)
        if below - above - 1 <= MAX_GAP
    ]


@pytest.mark.parametrize("share", [0.02, 0.2, 0.5, 0.9, 1.0])
def test_gaps_are_those_of_each_column(share):
    images = [image(share, seed=seed) for seed in range(3)]
    gaps = sum(len(column_gaps(column)) for one in images for column in one[0].T)
    occupied = sum(int((one[0] > 0).sum()) for one in images)
    assert row_gaps(images) == round(gaps / (gaps + occupied), 4)


@pytest.mark.parametrize("height", [1, 2, 24])
@pytest.mark.parametrize("share", [0.0, 0.1, 0.4, 1.0])
def test_empty_pixels_take_the_next_point_below(height, share):
    given = image(share, height)
    before = given.copy()
    filled = fill_rows(given)
    np.testing.assert_array_equal(given, before)
    for row, column in np.ndindex(given.shape[1:]):
        rows = range(row, min(row + FILLED_ROWS + 1, height))
        source = next((r for r in rows if given[0, r, column] > 0), row)
        np.testing.assert_array_equal(filled[:, row, column], given[:, source, column])


@pytest.mark.parametrize(
    ("own", "trained", "filled"),
    [
        (0.4, 0.1, True),
        (0.15, 0.1, False),
        (0.4, 0.4, False),
        (None, 0.1, False),
        (0.4, None, False),
    ],
)
def test_gaps_are_filled_where_training_had_fewer(own, trained, filled):
    sensors = [replace(SMALL, row_gaps=gaps) for gaps in (own, trained)]
    assert fills_rows(*sensors) is filled
    given = image(0.4)
    np.testing.assert_array_equal(
        with_filled_gaps(given, *sensors), fill_rows(given) if filled else given
    )
