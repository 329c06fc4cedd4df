# SPDX-License-Identifier: MIT
"""Recorded drive: standing things stay where they are, the road is below, time goes on."""

import numpy as np
import pytest
from sklearn.neighbors import NearestNeighbors

from salsanext_cli.synthesis import surfaces
from salsanext_cli.synthesis.drive import record
from salsanext_cli.synthesis.rig import HDL64_MOUNT_M

SPACING = 2.5


@pytest.fixture(scope="module")
def frames():
    return list(record(7, 0, 3, SPACING))


def world(frame, labels):
    """Return the points of some classes, world coordinates."""
    chosen = np.isin(frame.labels, labels)
    return frame.scan.points[chosen] @ frame.pose[:3, :3].T + frame.pose[:3, 3]


def test_scans_look_like_an_hdl64s_above_the_road(frames):
    for frame in frames:
        scan = frame.scan
        assert len(scan) == len(frame.labels)
        assert 60_000 < len(scan) < 135_000
        reach = np.linalg.norm(scan.points, axis=1)
        assert reach.min() > 1
        assert reach.max() < 82
        assert len(np.unique(frame.labels)) > 8
        road = scan.points[np.isin(frame.labels, (surfaces.ROAD, surfaces.MARKING))]
        near = road[np.hypot(road[:, 0], road[:, 1]) < 8]
        assert np.median(near[:, 2]) == pytest.approx(-HDL64_MOUNT_M, abs=0.15)
        assert near[:, 2].std() < 0.15


def test_standing_things_stay_where_they_are(frames):
    still = (surfaces.BUILDING, surfaces.FENCE, surfaces.POLE, surfaces.CLUTTER, surfaces.CAR)
    first, second = (world(frame, still) for frame in frames[:2])
    here = first[np.linalg.norm(first - frames[1].pose[:3, 3], axis=1) < 12]
    distance, _ = NearestNeighbors(n_neighbors=1).fit(second).kneighbors(here)
    assert np.median(distance) < 0.12
    shifted, _ = NearestNeighbors(n_neighbors=1).fit(second + [0.4, 0.3, 0.5]).kneighbors(here)
    assert np.median(shifted) > 1.5 * np.median(distance)


def test_poses_are_rigid_and_so_far_apart(frames):
    for frame in frames:
        rotation = frame.pose[:3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(rotation) == pytest.approx(1)
    steps = np.diff([frame.pose[:3, 3] for frame in frames], axis=0)
    np.testing.assert_allclose(np.linalg.norm(steps, axis=1), SPACING, rtol=0.1)
    ahead = np.array([frame.pose[:3, 0] for frame in frames[:-1]])
    assert ((steps * ahead).sum(1) > 0.95 * SPACING).all()


def test_moving_things_are_not_where_they_were():
    moving = tuple(surfaces.MOVING.values())
    before, after = (world(frame, moving) for frame in record(7, 1, 2, 3.0))
    assert len(before)
    assert len(after)
    distance, _ = NearestNeighbors(n_neighbors=1).fit(after).kneighbors(before)
    assert np.median(distance) > 0.2
