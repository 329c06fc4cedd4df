# SPDX-License-Identifier: MIT
import numpy as np
import pytest

from salsanext_cli.io.formats.survey.local_frame import CELL_M, NO_SHIFT, local_frame


def test_clouds_around_their_sensor_stay():
    assert local_frame(np.array([[-180.0, -120, -3], [200, 160, 20]])) == NO_SHIFT
    assert local_frame(np.array([[4000.0, -4000, 900], [4100, -3900, 950]])) == NO_SHIFT


@pytest.mark.parametrize("middle", [(500_123.4, 5_400_456.7), (-2_300_001.0, 1_999.0)])
def test_maps_are_near_the_origin_afterwards(middle):
    frame = local_frame(np.array([[*middle, 300], [*middle, 9]]))
    assert frame[2] == 0
    assert np.abs(np.subtract(middle, frame[:2])).max() <= CELL_M / 2
    assert [value % CELL_M for value in frame] == [0, 0, 0]
    # float32 keeps a quarter of a millimetre there.
    assert float(np.spacing(np.float32(CELL_M / 2))) / 2 <= 0.25e-3


def test_clouds_without_a_measurement_have_no_frame():
    assert local_frame(np.zeros((0, 3))) == NO_SHIFT
    assert local_frame(np.array([[0.0, 0, 0], [np.nan, 5e6, 0], [np.inf, 5e6, 0]])) == NO_SHIFT


def test_it_is_that_of_the_median_of_the_measurements():
    points = np.array([[5e5, 5.4e6, 10.0], [5e5 + 7, 5.4e6 + 8, 11]])
    strays = np.array([[0.0, 0, 0], [0, 0, 0], [0, 0, 0], [np.nan, 0, 0], [9e8, -9e8, 0]])
    assert local_frame(np.vstack([strays, points])) == (500_000, 5_400_000, 0)


def test_some_points_are_always_near_its_origin():
    """Half of them lie at one place, the others far away."""
    points = np.array([[5e5, 5.4e6, 0], [9e5, 9.4e6, 0]])
    assert local_frame(points) == (500_000, 5_400_000, 0)
