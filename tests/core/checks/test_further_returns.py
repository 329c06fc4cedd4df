# SPDX-License-Identifier: MIT
"""Further returns of a pulse are counted as a loop over the points of a file counts them."""

import numpy as np
import pytest

from salsanext_cli.core.checks.further_returns import (
    MAX_OFFSET_M,
    MIN_GAP_M,
    STEPS,
    count_further_returns,
)

ORIGIN = np.array([1.0, -2.0, 0.5])


def is_further(first: np.ndarray, second: np.ndarray) -> bool:
    """Return whether the second point is behind the first on one beam, by elementary geometry."""
    if not first.any():
        return False
    gap = np.linalg.norm(second) - np.linalg.norm(first)
    along = (second - first) / np.linalg.norm(second - first)
    offset = np.linalg.norm(first - (first @ along) * along)
    return gap > MIN_GAP_M and offset <= MAX_OFFSET_M


def slow_count(points: np.ndarray, hidden: np.ndarray) -> int:
    """Count with every step, one point after the other; return the largest number."""
    centred = points.astype(float) - ORIGIN
    counts = []
    for step in (*STEPS, len(points) // 2):
        count = 0
        for index in hidden:
            places = [place for place in (index - step, index + step) if 0 <= place < len(points)]
            count += any(is_further(centred[place], centred[index]) for place in places)
        counts.append(count)
    return max(counts)


def echoes(step: int, count: int = 256) -> tuple[np.ndarray, np.ndarray]:
    """Return points in the order of a file, and the indices of the second returns of pulses."""
    random = np.random.default_rng(step)
    directions = random.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    ranges = random.uniform(5, 30, count)
    hidden = np.flatnonzero(np.arange(count) // step % 2 == 1)
    directions[hidden] = directions[hidden - step]
    ranges[hidden] = ranges[hidden - step] + random.uniform(0.1, 9, len(hidden))
    points = ORIGIN + directions * ranges[:, None]
    return points.astype(np.float32), hidden


@pytest.mark.parametrize("step", [*STEPS[:3], 128])
def test_the_count_is_that_of_a_slow_loop(step):
    points, hidden = echoes(step)
    count = count_further_returns(points, ORIGIN, hidden)
    assert count == slow_count(points, hidden)
    assert count > 0.9 * len(hidden)


def test_hidden_points_of_other_directions_are_none():
    points, hidden = echoes(1)
    points[hidden] = np.roll(points[hidden], 7, axis=0)
    assert count_further_returns(points, ORIGIN, hidden) < 0.2 * len(hidden)


def test_a_first_return_in_the_origin_is_no_measurement():
    points = np.array([ORIGIN, ORIGIN + [5, 0, 0]], np.float32)
    assert count_further_returns(points, ORIGIN, np.array([1])) == 0
