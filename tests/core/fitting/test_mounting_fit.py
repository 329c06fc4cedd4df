# SPDX-License-Identifier: MIT
"""Ground and origin of scans of streets."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scans import SMALL
from street_scans import HEIGHT, moved, street

from salsanext_cli import Scan, project
from salsanext_cli.core.fitting.field_of_view import fit_view
from salsanext_cli.core.fitting.mounting_fit import fit_mounting
from salsanext_cli.core.geometry import beam_origin
from salsanext_cli.core.geometry.beam_origin import find_origin
from salsanext_cli.core.geometry.ground import find_ground
from salsanext_cli.core.geometry.projection import in_sensor_frame, upright_rotation
from salsanext_cli.core.geometry.sensor_place import USUAL_HEIGHT_M

PLACES = [(1.3, 0, 1.9), (-1.1, 0.4, 0.9)]


def objects(beams: int) -> Scan:
    """Points of a street that are not on the ground."""
    scan = street(beams)
    above = scan.points[:, 2] > 0.3 - HEIGHT
    return Scan(scan.points[above], scan.intensity[above])


DIRECTION = st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 0.1)


@pytest.mark.parametrize("height", [0.8, 1.7, 3.0])
def test_the_ground_of_a_street_and_not_its_walls(height):
    found = find_ground(street(0, height).points)
    assert found.height == pytest.approx(height, abs=0.05)
    assert found.tilt_deg < 2
    assert 0.1 < found.share < 1


@given(DIRECTION)
def test_the_ground_in_any_orientation(up):
    """The sensor turns about an axis of its frame, or near one."""
    axis = np.zeros(3)
    axis[np.abs(up).argmax()] = np.sign(up[int(np.abs(up).argmax())])
    points = street(0).points @ upright_rotation(axis)
    found = find_ground(points.astype(np.float32))
    assert found.up @ axis > 0.99
    assert found.height == pytest.approx(1.7, abs=0.05)


def test_points_without_a_ground():
    few = np.random.default_rng(0).normal(size=(20, 3)) * 10
    for points in (np.zeros((0, 3)), np.zeros((500, 3)), few, np.full((500, 3), 5.0)):
        assert find_ground(points.astype(np.float32)) is None


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


@pytest.mark.parametrize("beams", [16, 64])
@pytest.mark.parametrize("place", PLACES)
def test_the_origin_of_the_beams(beams, place):
    scan = moved(objects(beams), place)
    assert find_origin(scan.points) == pytest.approx(place, abs=0.05)


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


def test_a_sensor_on_the_ground_is_at_the_usual_height():
    """Its beams are not seen, as in clouds that were corrected for the vehicle's motion."""
    found = fit_mounting([moved(street(0), (0, 0, HEIGHT))] * 2, SMALL)
    assert found.origin == pytest.approx((0, 0, USUAL_HEIGHT_M), abs=0.1)
    ground = find_ground(in_sensor_frame(moved(street(0), (0, 0, HEIGHT)), found).points[::10])
    assert ground.height == pytest.approx(USUAL_HEIGHT_M, abs=0.1)


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


@pytest.mark.parametrize(("sharpest", "is_found"), [(1.5, False), (1.8, False), (2.4, True)])
def test_a_place_must_be_clearly_sharper_than_the_origin(monkeypatch, sharpest, is_found):
    """It hardly is in clouds that were accumulated on the way of a sensor."""

    def sharpness(_, place):
        return sharpest - 0.1 * np.linalg.norm(place - (0.9, 0, 1.7)) if place.any() else 1.3

    monkeypatch.setattr(beam_origin, "sharpness", sharpness)
    points = moved(objects(32), (0.9, 0, 1.7)).points
    assert (find_origin(points) is not None) == is_found


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
