# SPDX-License-Identifier: MIT
"""The point that all beams begin in."""

import math

import numpy as np
import pytest
from street_scans import HEIGHT, moved, street

from salsanext_cli import Scan
from salsanext_cli.core.geometry import beam_origin
from salsanext_cli.core.geometry.beam_origin import find_origin, sharpness

PLACES = [(1.3, 0, 1.9), (-1.1, 0.4, 0.9)]


def objects(beams: int) -> Scan:
    """Points of a street that are not on the ground."""
    scan = street(beams)
    above = scan.points[:, 2] > 0.3 - HEIGHT
    return Scan(scan.points[above], scan.intensity[above])


NOT_FINITE = [[np.nan, 1, 1], [1, np.nan, 1], [9, 1, np.nan], [np.inf, 1, np.inf]]


def sharpness_by_a_loop(points, place):
    """Return how much finer bins repeat than coarser ones around them."""
    histogram = [0] * 9001  # Of 0.02 degrees
    for x, y, z in points - place:
        elevation = math.degrees(math.atan2(z, math.hypot(x, y)))
        histogram[int((elevation + 90) / 0.02)] += 1

    def averaged(center, width):
        first = center - width // 2
        return sum(histogram[max(first, 0) : first + width]) / width

    fine = [averaged(center, 3) for center in range(9001)]
    coarse = [averaged(center, 51) for center in range(9001)]
    products = sum(first * second for first, second in zip(fine, coarse, strict=True))
    return sum(value * value for value in fine) / products


@pytest.mark.parametrize("others", [[], NOT_FINITE])
def test_sharpness_by_a_plain_loop(others):
    random = np.random.default_rng(0)
    elevations = np.deg2rad(random.choice([-90, -20, -10.4, -10, 3, 90], 300))
    azimuths = random.uniform(-np.pi, np.pi, 300)
    level = np.cos(elevations)
    units = np.stack([level * np.cos(azimuths), level * np.sin(azimuths), np.sin(elevations)], 1)
    place = np.array([0.5, -0.2, 1.7])
    points = random.uniform(5, 40, (300, 1)) * units + place + random.normal(0, 0.01, (300, 3))
    expected = sharpness_by_a_loop(points, place)
    assert expected > 2
    every = np.concatenate([points, np.reshape(others, (-1, 3))])
    assert sharpness(every, place) == pytest.approx(expected)


@pytest.mark.parametrize("beams", [16, 64])
@pytest.mark.parametrize("place", PLACES)
def test_the_origin_of_the_beams(beams, place):
    scan = moved(objects(beams), place)
    assert find_origin(scan.points) == pytest.approx(place, abs=0.05)


@pytest.mark.parametrize(("sharpest", "is_found"), [(1.5, False), (1.8, False), (2.4, True)])
def test_a_place_must_be_clearly_sharper_than_the_origin(monkeypatch, sharpest, is_found):
    """It hardly is in clouds that were accumulated on the way of a sensor."""

    def sharpness(_, place):
        return sharpest - 0.1 * np.linalg.norm(place - (0.9, 0, 1.7)) if place.any() else 1.3

    monkeypatch.setattr(beam_origin, "sharpness", sharpness)
    points = moved(objects(32), (0.9, 0, 1.7)).points
    assert (find_origin(points) is not None) == is_found
