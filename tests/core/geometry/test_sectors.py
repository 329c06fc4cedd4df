# SPDX-License-Identifier: MIT
"""Sectors around a sensor: against an angle in turns, point by point."""

import math

import numpy as np
import pytest

from salsanext_cli.core.geometry.sectors import SECTORS, occupied_sectors, sector_of_points


def circle(begin, end, count=640, dtype=np.float32):
    """Return points at azimuths between two shares of the circle, from the positive x axis."""
    angles = 2 * np.pi * np.linspace(begin, end, count, endpoint=False)
    return np.stack([9 * np.cos(angles), 9 * np.sin(angles), np.ones(count)], axis=1).astype(dtype)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_the_sector_of_a_point_is_the_part_of_the_circle_with_its_angle(dtype):
    points = np.random.default_rng(0).normal(0, 20, (300, 3)).astype(dtype)
    expected = []
    for x, y, _ in points.tolist():
        turn = (math.atan2(y, x) + math.pi) / (2 * math.pi)
        expected.append(int(SECTORS * turn) % SECTORS)
    assert sector_of_points(points).tolist() == expected


def test_the_negative_x_axis_begins_the_first_sector_from_both_sides():
    points = np.array([[-5, 0.0, 0], [-5, -0.0, 0]], np.float32)
    assert sector_of_points(points).tolist() == [0, 0]


@pytest.mark.parametrize(
    ("begin", "end", "share"), [(0, 1, 1.0), (0, 0.5, 0.5), (0.125, 0.375, 0.25), (0, 0, 1 / 64)]
)
def test_the_share_of_occupied_sectors_is_that_of_the_arc(begin, end, share):
    assert occupied_sectors(circle(begin, end)) == pytest.approx(share, abs=1 / SECTORS)


def test_no_points_occupy_no_sector():
    assert occupied_sectors(np.zeros((0, 3), np.float32)) == 0
