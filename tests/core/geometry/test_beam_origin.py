# SPDX-License-Identifier: MIT
"""The point that all beams begin in."""

import numpy as np
import pytest
from street_scans import HEIGHT, moved, street

from salsanext_cli import Scan
from salsanext_cli.core.geometry import beam_origin
from salsanext_cli.core.geometry.beam_origin import find_origin

PLACES = [(1.3, 0, 1.9), (-1.1, 0.4, 0.9)]


def objects(beams: int) -> Scan:
    """Points of a street that are not on the ground."""
    scan = street(beams)
    above = scan.points[:, 2] > 0.3 - HEIGHT
    return Scan(scan.points[above], scan.intensity[above])


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
