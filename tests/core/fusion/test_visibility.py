# SPDX-License-Identifier: MIT
"""Scans see something at a place, or through it, as elementary geometry has it."""

import math

import numpy as np

from salsanext_cli.core.fusion.visibility import (
    COLUMNS,
    GRAZING,
    ROWS,
    SAME_PLACE_M,
    nearest_ranges,
    seen_by,
)


def direction(point: np.ndarray) -> int | None:
    """Return the number of the direction of a point, None outside 45° up and down."""
    x, y, z = map(float, point)
    column = int((math.atan2(y, x) / math.pi + 1) / 2 * COLUMNS)
    row = math.floor((math.atan2(z, math.hypot(x, y)) / (math.pi / 2) + 0.5) * ROWS)
    return row * COLUMNS + min(column, COLUMNS - 1) if 0 <= row < ROWS else None


def scan(seed: int, count: int = 3000) -> np.ndarray:
    points = np.random.default_rng(seed).normal(scale=[12, 12, 4], size=(count, 3))
    points[:3] = [[0, 0, 0], [np.nan, 1, 1], [0.1, 0, 9]]
    return points.astype(np.float32)


def test_the_nearest_range_of_each_direction_is_that_of_a_slow_loop():
    points = scan(0)
    expected: dict[int, float] = {}
    for point in points.astype(float):
        distance = np.linalg.norm(point)
        place = direction(point) if distance > 0 else None
        if place is not None:
            expected[place] = min(distance, expected.get(place, math.inf))
    ranges = nearest_ranges(points)
    seen = np.flatnonzero(np.isfinite(ranges))
    assert {*seen.tolist()} == {*expected}
    np.testing.assert_allclose(ranges[seen], [expected[place] for place in seen], rtol=1e-6)


def test_scans_that_see_a_place_or_through_it_are_those_of_a_slow_loop():
    turn = np.radians(30)
    rotation = np.array(
        [[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1.0]]
    )
    position = np.array([2.0, -1.0, 0.3])
    points = scan(1)[3:].astype(float)
    ranges = nearest_ranges(points.astype(np.float32))
    # Places in front of the points, on them and behind them
    factors = np.random.default_rng(2).choice([0.5, 0.99, 1.0, 1.3], (len(points), 1))
    places = (factors * points) @ rotation.T + position
    expected = np.zeros((2, len(places)), int)
    for number, place in enumerate(places):
        local = rotation.T @ (place - position)
        at = direction(local)
        if at is not None:
            distance = np.linalg.norm(local)
            behind = ranges[at] - distance
            expected[0, number] = abs(behind) <= SAME_PLACE_M
            expected[1, number] = behind > SAME_PLACE_M + GRAZING * distance
    counts = seen_by(places, [(rotation, position, ranges)])
    np.testing.assert_array_equal(counts, expected)
    assert expected.sum(axis=1).min() > 100
    twice = seen_by(places, [(rotation, position, ranges)] * 2)
    np.testing.assert_array_equal(twice, 2 * expected)
