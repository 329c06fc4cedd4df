# SPDX-License-Identifier: MIT
import numpy as np
import pytest

from salsanext_cli.io.formats.survey.local_frame import CELL_M, NO_SHIFT, local_frame


def test_clouds_around_their_sensor_stay():
    assert local_frame((-180, -120, -3), (200, 160, 20)) == NO_SHIFT
    assert local_frame((4000, -4000, 900), (4100, -3900, 950)) == NO_SHIFT


@pytest.mark.parametrize("middle", [(500_123.4, 5_400_456.7), (-2_300_001.0, 1_999.0)])
def test_maps_are_near_the_origin_afterwards(middle):
    frame = local_frame(
        (middle[0] - 100, middle[1] - 50, 300), (middle[0] + 100, middle[1] + 50, 9)
    )
    assert frame[2] == 0
    assert np.abs(np.subtract(middle, frame[:2])).max() <= CELL_M / 2
    assert [value % CELL_M for value in frame] == [0, 0, 0]
    # float32 keeps a quarter of a millimetre there.
    assert float(np.spacing(np.float32(CELL_M / 2))) / 2 <= 0.25e-3


def test_bounds_that_are_not_finite_have_no_frame():
    assert local_frame((np.nan, 0, 0), (5e6, 5e6, 0)) == NO_SHIFT
    assert local_frame((-np.inf, 0, 0), (np.inf, 5e6, 0)) == NO_SHIFT
