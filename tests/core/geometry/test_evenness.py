# SPDX-License-Identifier: MIT
"""Evenness of directions around a position."""

import math

import numpy as np
import pytest
from street_scans import street

from salsanext_cli.core.geometry.evenness import evenness, hidden_share, is_even_fan, is_fan

OFFSETS = [0.0, 0.3, 0.75]
NOT_FINITE = [[np.nan, 1, 1], [1, np.nan, 1], [30, 1, np.nan], [np.inf, 1, 1], [-np.inf, np.inf, 0]]


def evenness_by_a_loop(points, place, offset):
    """Return the evenness of points; those that are not finite count as near ones."""
    counts: dict[tuple[int, int], int] = {}
    far = 0
    for x, y, z in points - place:
        distance = math.sqrt(x * x + y * y + z * z)
        if not 3 < distance < math.inf:
            continue
        far += 1
        around = math.floor(math.degrees(math.atan2(y, x)) + 180 + offset)
        upwards = math.floor(math.degrees(math.atan2(z, math.hypot(x, y))) + 90 + offset)
        counts[around, upwards] = counts.get((around, upwards), 0) + 1
    return far * far / sum(count * count for count in counts.values()) / len(points)


@pytest.mark.parametrize("others", [[], NOT_FINITE])
def test_evenness_by_a_plain_loop(others):
    random = np.random.default_rng(0)
    points = random.normal(size=(2000, 3)) * [10, 10, 3]
    points = np.concatenate([points, np.reshape(others, (-1, 3))])
    place = np.array([1.0, 2.0, 0.5])
    expected = [evenness_by_a_loop(points, place, offset) for offset in OFFSETS]
    assert len({*expected}) == len(OFFSETS), "the offsets matter"
    assert evenness(points, place) == pytest.approx(expected[0])
    assert evenness(points, place, OFFSETS) == pytest.approx(np.mean(expected))


def test_hidden_points_by_a_plain_loop():
    random = np.random.default_rng(1)
    points = random.normal(size=(3000, 3)) * [20, 20, 1]
    nearest: dict[tuple[int, int], float] = {}
    rows = []
    for x, y, z in points:
        around = math.floor(math.degrees(math.atan2(y, x)) + 180)
        upwards = math.floor(math.degrees(math.atan2(z, math.hypot(x, y))) + 90)
        distance = math.sqrt(x * x + y * y + z * z)
        cell = around, upwards
        nearest[cell] = min(nearest.get(cell, math.inf), distance)
        rows.append((cell, distance))
    hidden = sum(distance > 1 + 1.05 * nearest[cell] for cell, distance in rows)
    assert hidden > 100
    assert hidden_share(points.reshape(-1)) == hidden / 3000


def test_a_fan_is_even_from_its_tip_only():
    scan = street(0)
    assert not is_fan(scan)
    assert not is_even_fan(scan)
    azimuth = np.abs(np.arctan2(scan.points[:, 1], scan.points[:, 0]))
    ahead = scan.take(np.flatnonzero(azimuth < 0.6))
    assert is_fan(ahead)
    assert is_even_fan(ahead)
    # As from a position beside the fan, more than half of the points lie in one direction.
    narrow = np.flatnonzero(azimuth < 0.03)
    crowded = scan.take(np.concatenate([np.flatnonzero(azimuth < 0.6), np.repeat(narrow, 30)]))
    assert is_fan(crowded)
    assert not is_even_fan(crowded)
