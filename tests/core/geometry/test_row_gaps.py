# SPDX-License-Identifier: MIT
"""Gaps between the rows of a range image, and how they are filled."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scans import SMALL

from salsanext_cli.core.geometry.row_gaps import (
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


def rows_in_gaps(ranges):
    """Return the rows in gaps of one column, pixel by pixel."""
    full = [row for row, distance in enumerate(ranges) if distance > 0]
    return [
        row
        for above, below in pairwise(full)
        for row in range(above + 1, below)
        if below - above - 1 <= MAX_GAP
    ]


@pytest.mark.parametrize("height", [2, 5, 24])
@pytest.mark.parametrize("share", [0.02, 0.2, 0.5, 0.9, 1.0])
def test_gaps_equal_a_loop_over_columns(share, height):
    """Without a point on both sides, there is no gap, in a low image either."""
    images = [image(share, height, seed=seed) for seed in range(3)]
    gaps = sum(len(rows_in_gaps(column)) for channels in images for column in channels[0].T)
    occupied = sum(int((channels[0] > 0).sum()) for channels in images)
    assert row_gaps(images) == round(gaps / (gaps + occupied), 4)


@pytest.mark.parametrize("height", [1, 2, 24])
@pytest.mark.parametrize("share", [0.0, 0.1, 0.4, 1.0])
def test_empty_pixels_take_the_next_point_below(height, share):
    channels = image(share, height)
    before = channels.copy()
    filled = fill_rows(channels)
    np.testing.assert_array_equal(channels, before)
    for row, column in np.ndindex(channels.shape[1:]):
        rows = range(row, min(row + FILLED_ROWS + 1, height))
        source = next((r for r in rows if channels[0, r, column] > 0), row)
        np.testing.assert_array_equal(filled[:, row, column], channels[:, source, column])


@pytest.mark.parametrize(
    ("gaps", "trained_gaps", "are_filled"),
    [
        (0.4, 0.1, True),
        (0.15, 0.1, False),
        (0.4, 0.4, False),
        (None, 0.1, False),
        (0.4, None, False),
    ],
)
def test_gaps_are_filled_where_training_had_fewer(gaps, trained_gaps, are_filled):
    sensor = replace(SMALL, row_gaps=gaps)
    trained = replace(SMALL, row_gaps=trained_gaps)
    assert fills_rows(sensor, trained) is are_filled
    channels = image(0.4)
    expected = fill_rows(channels) if are_filled else channels
    np.testing.assert_array_equal(with_filled_gaps(channels, sensor, trained), expected)
