# SPDX-License-Identifier: MIT
"""Random sensors: within their bounds, different, and on the street that others see."""

from dataclasses import replace

import numpy as np
import pytest

from salsanext_cli.synthesis import surfaces
from salsanext_cli.synthesis.drive import record
from salsanext_cli.synthesis.presets import RANDOM_SENSOR
from salsanext_cli.synthesis.sensor.rig import RIGS

SEEDS = range(60)


@pytest.fixture(scope="module")
def rigs():
    return [RIGS["random"](np.random.default_rng(seed)) for seed in SEEDS]


def test_a_random_sensor_is_within_its_bounds(rigs):
    for rig in rigs:
        beams = rig.beams
        degrees = np.degrees(beams.elevation)
        assert (np.diff(degrees) < 0).all()
        assert 12 <= len(degrees) <= 128
        assert RANDOM_SENSOR["down"][0] - 2 < degrees.min() < RANDOM_SENSOR["down"][1] + 6
        assert RANDOM_SENSOR["up"][0] - 6 < degrees.max() < RANDOM_SENSOR["up"][1] + 2
        assert len(degrees) * beams.columns <= RANDOM_SENSOR["rays"]
        assert len(rig.seen) == len(degrees) * beams.columns == len(beams.rays()[0])
        assert RANDOM_SENSOR["mount"][0] <= rig.mount <= RANDOM_SENSOR["mount"][1]
        assert rig.response.nearest < rig.response.farthest


def test_random_sensors_differ(rigs):
    assert {len(rig.beams.elevation) for rig in rigs} >= {16, 32, 64, 128}
    assert np.std([rig.mount for rig in rigs]) > 0.3
    assert np.std([rig.response.gain for rig in rigs]) > 0.2
    unhidden = [rig.seen.all() for rig in rigs]
    assert 10 < sum(unhidden) < 50
    steps = [-np.diff(np.degrees(rig.beams.elevation)) for rig in rigs]
    uneven = [step.max() > 2.5 * np.median(step) for step in steps]
    assert 10 < sum(uneven) < 55


def test_a_seed_has_one_sensor_per_sequence():
    for sequence in range(2):
        frame, again = (next(record(4, sequence, 1, 3.0, "random")) for _ in range(2))
        np.testing.assert_array_equal(frame.scan.points, again.scan.points)
        np.testing.assert_array_equal(frame.scan.intensity, again.scan.intensity)


@pytest.mark.parametrize("mount", [1.2, 2.6])
def test_the_road_is_as_far_below_as_the_sensor_is_mounted(mount, monkeypatch):
    usual = RIGS["hdl64"]
    monkeypatch.setitem(RIGS, "random", lambda rng: replace(usual(rng), mount=mount))
    frame = next(record(4, 0, 1, 3.0, "random"))
    points = frame.scan.points[np.isin(frame.labels, (surfaces.ROAD, surfaces.MARKING))]
    near = points[np.hypot(points[:, 0], points[:, 1]) < 9]
    assert np.median(near[:, 2]) == pytest.approx(-mount, abs=0.15)


def test_the_street_is_the_same_through_any_sensor():
    frames = {sensor: next(record(4, 1, 1, 3.0, sensor)) for sensor in RIGS}
    places = []
    for frame in frames.values():
        chosen = np.isin(frame.labels, (surfaces.BUILDING, surfaces.FENCE))
        near = np.linalg.norm(frame.scan.points, axis=1) < 25
        points = frame.scan.points[chosen & near]
        world = points @ frame.pose[:3, :3].T + frame.pose[:3, 3]
        places.append(set(map(tuple, np.round(world[:, :2]).astype(int).tolist())))
    common = len(places[0] & places[1])
    assert common > 0.6 * min(map(len, places))
