# SPDX-License-Identifier: MIT
import numpy as np
import pytest
from test_poses import street

from salsanext_cli.fusion.poses import segments
from salsanext_cli.fusion.registration import register

pytest.importorskip("small_gicp")


def test_the_way_is_found_from_the_scans_alone():
    poses, seen = street()
    found = register(seen(number) for number in range(len(poses)))
    np.testing.assert_allclose(found[:, :3, 3], poses[:, :3, 3], atol=0.1)
    np.testing.assert_allclose(found[:, :3, :3], poses[:, :3, :3], atol=0.01)


def test_what_does_not_lie_on_the_scan_before_begins_a_part():
    _, seen = street()
    elsewhere = np.random.default_rng(1).uniform([-30, -15, -1.7], [30, 15, 2], (8000, 3))
    nothing = np.zeros((10, 3))
    found = register([seen(0), seen(1), elsewhere, nothing, seen(0), seen(1)])
    assert segments(found).tolist() == [0, 0, 1, 2, 3, 3]
    np.testing.assert_allclose(np.linalg.inv(found[4]) @ found[5], found[1], atol=0.1)


def test_no_scans_have_no_poses():
    assert register([]).shape == (0, 4, 4)
