# SPDX-License-Identifier: MIT
"""Ground and origin of scans of streets."""

from dataclasses import replace

import numpy as np
import pytest
from scans import SMALL
from street_scans import HEIGHT, moved, street

from salsanext_cli import Scan, project
from salsanext_cli.core.fitting.field_of_view import fit_view
from salsanext_cli.core.fitting.mounting_fit import fit_mounting
from salsanext_cli.core.geometry.sensor_frame import upright_rotation


def test_the_direction_ahead_stays_ahead():
    """Hanging, lying, leaning sensors, and the frames of cameras, whose z is ahead and y down."""
    for up, ahead in (
        ((0, 0, 2), (1, 0, 0)),
        ((0.01, -0.02, -1), (1, 0, 0)),
        ((0, 1, 0), (1, 0, 0)),
        ((0, -1, 0.1), (0, 0, 1)),
        ((1, 0, 0), (0, 0, 1)),
        ((0.3, 0, 1), (1, 0, 0)),
    ):
        assert upright_rotation(np.array(up, float))[0] @ ahead > 0.95


@pytest.mark.parametrize("up", [(0, 0, 1), (0, 1, 0)])
def test_scans_in_the_frame_of_a_vehicle_make_the_images_of_their_sensor(up):
    """In frames with z or y up, up to the direction ahead."""
    turn = upright_rotation(np.array(up, float))
    scans = [
        Scan((moved(scan, (0.9, 0, HEIGHT)).points @ turn).astype(np.float32), scan.intensity)
        for scan in (street(32, seed=seed) for seed in range(3))
    ]
    found = fit_view(scans, SMALL)
    assert np.dot(found.up, up) > 0.99
    assert turn @ found.origin == pytest.approx((0.9, 0, HEIGHT), abs=0.15)
    image, expected = project(scans[0], found), project(street(32), SMALL)
    same = (image.channels[0] > 0) & (expected.channels[0] > 0)
    if up == (0, 0, 1):
        difference = np.abs(image.channels[:4, same] - expected.channels[:4, same])
        assert np.quantile(difference, 0.9) < 0.15


@pytest.mark.parametrize("height", [0.5, HEIGHT, 4.0])
@pytest.mark.parametrize("beams", [0, 32])
def test_scans_of_robots_cars_and_masts_stay_where_they_are(beams, height):
    assert fit_mounting([street(beams, height)], SMALL) == SMALL


def test_a_sensor_on_the_floor_stays_where_its_beams_come_from():
    """Hardly a point of it is above the floor."""
    floor = street(64, 0.1)
    low = np.flatnonzero(floor.points[:, 2] < 0.2)
    rest = np.flatnonzero(floor.points[:, 2] >= 0.3)[: len(low) // 40]
    repeated = np.concatenate([np.tile(low, 30), np.tile(rest, 30)])
    assert fit_mounting([floor.take(repeated)], SMALL) == SMALL


def test_points_without_a_measurement_get_none_in_another_frame():
    points = np.array([[0, 0, 0], [5, 1, 0], [np.nan, 0, 0]], np.float32)
    sensor = replace(SMALL, origin=(0.5, 0.0, 1.7), out_of_view="clamp")
    image = project(Scan(points, np.ones(3, np.float32)), sensor)
    assert (image.pixel_of_point >= 0).tolist() == [False, True, False]


@pytest.mark.parametrize("other", [{"origin": (2.0, 0.0, 1.0)}, {"up": (0.0, 1.0, 0.0)}])
def test_the_mounting_of_other_scans_is_not_used(other):
    """As that of weights that were tuned on them, which an earlier version did."""
    for scans in ([street(32)], [moved(street(32), (0.9, 0, HEIGHT))]):
        found = fit_mounting(scans, replace(SMALL, **other))
        assert found.origin == fit_mounting(scans, SMALL).origin


@pytest.mark.parametrize("beams", [0, 32])
def test_a_sensor_kilometres_from_the_origin_is_found(beams):
    """As in the local frame of a map, from whose origin all points lie in one direction."""
    place = (1234.0, -3211.0, 520.0)
    found = fit_mounting([moved(street(beams), place)], SMALL)
    assert np.abs(np.subtract(found.origin, place)).max() < 1
