# SPDX-License-Identifier: MIT
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from streets import street_points

from salsanext_cli.fitting.mounting_fit import find_ground
from salsanext_cli.geometry.projection import upright_rotation

DIRECTION = st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 0.1)


def street(height=1.7, seed=0):
    random = np.random.default_rng(seed)
    azimuth = random.uniform(-np.pi, np.pi, 6000)
    elevation = np.radians(random.uniform(-25, 3, 6000))
    return street_points(azimuth, elevation, height, 60, random.normal(0, 0.02, 6000))


@pytest.mark.parametrize("height", [0.8, 1.7, 3.0])
def test_the_ground_of_a_street_and_not_its_walls(height):
    found = find_ground(street(height))
    assert found.height == pytest.approx(height, abs=0.05)
    assert found.tilt_deg < 2
    assert 0.1 < found.share < 1


@given(DIRECTION)
def test_in_any_orientation(up):
    """Of a sensor that turns about an axis of its frame, or near one."""
    axis = np.zeros(3)
    axis[np.abs(up).argmax()] = np.sign(up[int(np.abs(up).argmax())])
    points = street() @ upright_rotation(axis)
    found = find_ground(points.astype(np.float32))
    assert found.up @ axis > 0.99
    assert found.height == pytest.approx(1.7, abs=0.05)


@pytest.mark.parametrize(
    "points",
    [
        np.zeros((0, 3)),
        np.zeros((500, 3)),
        np.random.default_rng(0).normal(size=(20, 3)) * 10,
        np.full((500, 3), 5.0),
    ],
)
def test_where_there_is_none(points):
    assert find_ground(points.astype(np.float32)) is None


@pytest.mark.parametrize(
    ("up", "ahead"),
    [
        ((0, 0, 2), (1, 0, 0)),
        ((0.01, -0.02, -1), (1, 0, 0)),
        ((0, 1, 0), (1, 0, 0)),
        ((0, -1, 0.1), (0, 0, 1)),
        ((1, 0, 0), (0, 0, 1)),
        ((0.3, 0, 1), (1, 0, 0)),
    ],
)
def test_what_is_ahead_stays_ahead(up, ahead):
    """Hanging, lying, leaning sensors, and the frames of cameras, whose z is ahead and y down."""
    assert upright_rotation(np.array(up, float))[0] @ ahead > 0.95
