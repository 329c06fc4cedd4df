# SPDX-License-Identifier: MIT
"""Beams of an HDL-64E: angles, order, timing, and those that the vehicle hides."""

import numpy as np
import pytest

from salsanext_cli.synthesis.rig import ENCODER_STEP_DEG, LOWER_BLOCK, UPPER_BLOCK, hdl64_rig


@pytest.fixture(scope="module")
def rig():
    return hdl64_rig(np.random.default_rng(3))


@pytest.fixture(scope="module")
def beams(rig):
    return rig.beams


def test_elevations_are_the_sensors_own_in_two_blocks(beams):
    degrees = np.degrees(beams.elevation)
    assert (np.diff(degrees) < 0).all()
    nominal = np.concatenate([np.linspace(*UPPER_BLOCK), np.linspace(*LOWER_BLOCK)])
    assert np.abs(degrees - nominal).max() < 0.5
    assert -np.diff(degrees[:32]).mean() == pytest.approx(1 / 3, abs=0.02)
    assert -np.diff(degrees[32:]).mean() == pytest.approx(1 / 2, abs=0.02)


def test_rays_are_unit_vectors_at_the_beams_angles(beams):
    origins, directions, _ = beams.rays()
    count = 64 * beams.columns
    assert np.linalg.norm(origins, axis=1).max() < 0.1
    assert origins.shape == directions.shape == (count, 3)
    assert 125_000 < count < 145_000
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1, atol=1e-12)
    elevation = np.arcsin(directions[:, 2]).reshape(64, -1)
    np.testing.assert_allclose(elevation, np.repeat(beams.elevation[:, None], beams.columns, 1))


def test_a_laser_goes_once_around_anticlockwise_in_steps_of_the_encoder(beams):
    _, directions, _ = beams.rays()
    azimuth = np.degrees(np.arctan2(directions[:, 1], directions[:, 0])).reshape(64, -1)
    steps = np.diff(np.unwrap(azimuth, axis=1, period=360), axis=1)
    multiples = steps / ENCODER_STEP_DEG
    np.testing.assert_allclose(multiples, np.round(multiples), atol=1e-6)
    assert set(np.round(multiples).astype(int).ravel()) == {1, 2}
    assert steps.sum(1).max() < 360


def test_the_sensor_looks_ahead_at_time_zero_and_turns_clockwise(beams):
    _, directions, times = beams.rays()
    azimuth = np.degrees(np.arctan2(directions[:, 1], directions[:, 0]))
    assert np.abs(times).max() <= 0.05
    np.testing.assert_allclose(times, -azimuth / 3600, atol=1e-9)


def test_the_vehicle_hides_only_low_beams_and_a_small_part(rig, beams):
    hidden = ~rig.seen.reshape(64, -1)
    assert not hidden[np.degrees(beams.elevation) > -12.5].any()
    assert 0.02 < hidden.mean() < 0.12
    straight_back, sideways = beams.columns // 2, beams.columns // 4
    assert hidden[-1, straight_back]
    assert not hidden[-1, sideways]
