# SPDX-License-Identifier: MIT
"""The ground below the sensor."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scans import SMALL
from street_scans import HEIGHT, moved, street

from salsanext_cli.core.fitting.mounting_fit import fit_mounting
from salsanext_cli.core.geometry.ground import find_ground
from salsanext_cli.core.geometry.sensor_frame import in_sensor_frame, upright_rotation
from salsanext_cli.core.geometry.sensor_place import USUAL_HEIGHT_M

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


def test_a_sensor_on_the_ground_is_at_the_usual_height():
    """Its beams are not seen, as in clouds that were corrected for the vehicle's motion."""
    found = fit_mounting([moved(street(0), (0, 0, HEIGHT))] * 2, SMALL)
    assert found.origin == pytest.approx((0, 0, USUAL_HEIGHT_M), abs=0.1)
    ground = find_ground(in_sensor_frame(moved(street(0), (0, 0, HEIGHT)), found).points[::10])
    assert ground.height == pytest.approx(USUAL_HEIGHT_M, abs=0.1)
