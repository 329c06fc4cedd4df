# SPDX-License-Identifier: MIT
"""Sensors on their vehicle, and the drives that they record."""

import numpy as np
import pytest
from scipy.spatial import KDTree

from salsanext_cli.synthesis import presets
from salsanext_cli.synthesis.drive import record
from salsanext_cli.synthesis.lidar import (
    ENCODER_STEP_DEG,
    HDL64_MOUNT_M,
    LOWER_BLOCK,
    RIGS,
    UPPER_BLOCK,
    hdl64_rig,
    random_rig,
)
from salsanext_cli.synthesis.presets import RANDOM_SENSOR


@pytest.fixture(scope="module")
def rig():
    return hdl64_rig(np.random.default_rng(3))


@pytest.fixture(scope="module")
def beams(rig):
    return rig.beams


def test_elevations_form_two_blocks(beams):
    degrees = np.degrees(beams.elevation)
    assert (np.diff(degrees) < 0).all()
    nominal = np.concatenate([np.linspace(*UPPER_BLOCK), np.linspace(*LOWER_BLOCK)])
    assert np.abs(degrees - nominal).max() < 0.5
    assert -np.diff(degrees[:32]).mean() == pytest.approx(1 / 3, abs=0.02)
    assert -np.diff(degrees[32:]).mean() == pytest.approx(1 / 2, abs=0.02)


def test_rays_turn_clockwise_in_steps_of_the_encoder_ahead_at_time_zero(beams):
    """As unit vectors at the elevations of the beams; each laser goes once around."""
    origins, directions, times = beams.rays()
    count = 64 * beams.columns
    assert np.linalg.norm(origins, axis=1).max() < 0.1
    assert origins.shape == directions.shape == (count, 3)
    assert 125_000 < count < 145_000
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1, atol=1e-12)
    elevation = np.arcsin(directions[:, 2]).reshape(64, -1)
    np.testing.assert_allclose(elevation, np.repeat(beams.elevation[:, None], beams.columns, 1))
    azimuth = np.degrees(np.arctan2(directions[:, 1], directions[:, 0]))
    steps = np.diff(np.unwrap(azimuth.reshape(64, -1), axis=1, period=360), axis=1)
    multiples = steps / ENCODER_STEP_DEG
    np.testing.assert_allclose(multiples, np.round(multiples), atol=1e-6)
    assert set(np.round(multiples).astype(int).ravel()) == {1, 2}
    assert steps.sum(1).max() < 360
    assert np.abs(times).max() <= 0.05
    np.testing.assert_allclose(times, -azimuth / 3600, atol=1e-9)


def test_the_vehicle_hides_only_low_beams_and_a_small_part(rig, beams):
    hidden = ~rig.unblocked.reshape(64, -1)
    assert not hidden[np.degrees(beams.elevation) > -12.5].any()
    assert 0.02 < hidden.mean() < 0.12
    straight_back, sideways = beams.columns // 2, beams.columns // 4
    assert hidden[-1, straight_back]
    assert not hidden[-1, sideways]


@pytest.fixture(scope="module")
def rigs():
    return [random_rig(np.random.default_rng(seed)) for seed in range(60)]


def test_random_sensors_are_within_bounds_and_no_vehicle_hides_the_sky(rigs):
    for rig in rigs:
        beams = rig.beams
        degrees = np.degrees(beams.elevation)
        assert (np.diff(degrees) < 0).all()
        assert 12 <= len(degrees) <= 128
        assert RANDOM_SENSOR.lower_edge[0] - 2 < degrees.min() < RANDOM_SENSOR.lower_edge[1] + 6
        assert RANDOM_SENSOR.upper_edge[0] - 6 < degrees.max() < RANDOM_SENSOR.upper_edge[1] + 2
        assert len(degrees) * beams.columns <= RANDOM_SENSOR.max_rays
        assert len(rig.unblocked) == len(degrees) * beams.columns == len(beams.rays()[0])
        assert RANDOM_SENSOR.mount[0] <= rig.mount <= RANDOM_SENSOR.mount[1]
        assert rig.response.nearest < rig.response.farthest
    hidden_shares = set()
    for rig in rigs:
        hidden = ~rig.unblocked.reshape(len(rig.beams.elevation), -1)
        assert not hidden[rig.beams.elevation >= 0].any()
        hidden_shares.add(round(hidden.mean(), 3))
    assert 0 in hidden_shares
    assert len(hidden_shares) > 10


@pytest.mark.slow
def test_a_seed_has_one_sensor_per_sequence():
    made = []

    def make_rig(rng):
        made.append(random_rig(rng))
        return made[-1]

    frames, again = (list(record(4, 0, 2, 3.0, make_rig)) for _ in range(2))
    assert len(made) == 2
    for frame, same in zip(frames, again, strict=True):
        np.testing.assert_array_equal(frame.scan.points, same.scan.points)
        np.testing.assert_array_equal(frame.scan.intensity, same.scan.intensity)
    next(record(4, 1, 1, 3.0, make_rig))
    first, _, other = made
    assert first.mount != other.mount
    assert first.response != other.response
    assert not np.array_equal(first.beams.elevation, other.beams.elevation)


@pytest.mark.slow
def test_the_street_is_the_same_through_any_sensor():
    frames = [next(record(4, 1, 1, 3.0, make_rig)) for make_rig in RIGS.values()]
    places = []
    for frame in frames:
        chosen = np.isin(frame.labels, (presets.BUILDING, presets.FENCE))
        near = np.linalg.norm(frame.scan.points, axis=1) < 25
        points = frame.scan.points[chosen & near]
        world = points @ frame.pose[:3, :3].T + frame.pose[:3, 3]
        places.append(set(map(tuple, np.round(world[:, :2]).astype(int).tolist())))
    common = len(places[0] & places[1])
    assert common > 0.6 * min(map(len, places))


SPACING = 2.5


@pytest.fixture(scope="module")
def frames():
    return list(record(7, 0, 3, SPACING))


def world(frame, labels):
    """Return the points of some classes, world coordinates."""
    chosen = np.isin(frame.labels, labels)
    return frame.scan.points[chosen] @ frame.pose[:3, :3].T + frame.pose[:3, 3]


def test_scans_resemble_those_of_an_hdl64(frames):
    for frame in frames:
        scan = frame.scan
        assert len(scan) == len(frame.labels)
        assert 60_000 < len(scan) < 135_000
        reach = np.linalg.norm(scan.points, axis=1)
        assert reach.min() > 1
        assert reach.max() < 82
        assert len(np.unique(frame.labels)) > 8
        road = scan.points[np.isin(frame.labels, (presets.ROAD, presets.MARKING))]
        near = road[np.hypot(road[:, 0], road[:, 1]) < 8]
        assert np.median(near[:, 2]) == pytest.approx(-HDL64_MOUNT_M, abs=0.15)
        assert near[:, 2].std() < 0.15


def test_static_objects_stay_and_poses_are_rigid_and_evenly_spaced(frames):
    still = (presets.BUILDING, presets.FENCE, presets.POLE, presets.CLUTTER, presets.CAR)
    first, second = (world(frame, still) for frame in frames[:2])
    here = first[np.linalg.norm(first - frames[1].pose[:3, 3], axis=1) < 12]
    distance, _ = KDTree(second).query(here)
    assert np.median(distance) < 0.12
    shifted, _ = KDTree(second + [0.4, 0.3, 0.5]).query(here)
    assert np.median(shifted) > 1.5 * np.median(distance)
    for frame in frames:
        rotation = frame.pose[:3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(rotation) == pytest.approx(1)
    steps = np.diff([frame.pose[:3, 3] for frame in frames], axis=0)
    np.testing.assert_allclose(np.linalg.norm(steps, axis=1), SPACING, rtol=0.1)
    ahead = np.array([frame.pose[:3, 0] for frame in frames[:-1]])
    assert ((steps * ahead).sum(1) > 0.95 * SPACING).all()


def test_moving_objects_change_position(frames):
    moving = tuple(presets.MOVING.values())
    before, after = (world(frame, moving) for frame in frames[:2])
    assert len(before)
    assert len(after)
    distance, _ = KDTree(after).query(before)
    assert np.median(distance) > 0.2
