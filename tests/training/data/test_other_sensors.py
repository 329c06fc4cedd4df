# SPDX-License-Identifier: MIT
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scans import SMALL, make_scan

from salsanext_cli import project
from salsanext_cli.training.data import other_sensors
from salsanext_cli.training.data.other_sensors import (
    EDGE_SHIFT_DEG,
    LOWERED_M,
    RAISED_M,
    change_intensity,
    fewer_beams,
    mount_otherwise,
    other_view,
)

SEEDS = st.integers(0, 999)


def rng(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed)


@given(SEEDS, st.sampled_from([1.0, 0.6, 255.0]))
def test_intensities_follow_one_law_of_intensity_and_range(seed: int, bright: float) -> None:
    """On whatever scale they are."""
    scan = make_scan(400, seed)
    scan = replace(scan, intensity=scan.intensity * np.float32(bright))
    drawn = rng(seed)
    gain, gamma = np.exp(drawn.normal(0, [0.3, 0.3]))
    power, offset = drawn.normal(0, [0.15, 0.05])
    expected = [
        bright
        * (gain * (i / bright) ** gamma * (np.linalg.norm(p.astype(float)) / 10) ** power + offset)
        for p, i in zip(scan.points, scan.intensity.astype(float), strict=True)
    ]
    found = change_intensity(scan, bright, rng(seed))
    np.testing.assert_allclose(found.intensity, expected, rtol=1e-4, atol=1e-5 * bright)
    np.testing.assert_array_equal(found.points, scan.points)


@given(SEEDS)
def test_another_place_is_a_small_rotation_and_a_shift_up_or_down(seed: int) -> None:
    points = make_scan(50, seed).points
    found = mount_otherwise(points, rng(seed)).astype(float)
    centred, moved = points - points.mean(axis=0), found - found.mean(axis=0)
    turn = np.linalg.lstsq(centred, moved, rcond=None)[0].T
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-4)
    assert np.linalg.det(turn) == pytest.approx(1, abs=1e-4)
    assert np.degrees(np.arccos(min(1, turn[2, 2]))) < 5
    # The axis is level: nothing turns about z.
    assert turn[0, 1] - turn[1, 0] == pytest.approx(0, abs=1e-4)
    offset = found.mean(axis=0) - turn @ points.mean(axis=0)
    np.testing.assert_allclose(offset[:2], 0, atol=1e-3)
    assert -RAISED_M - 1e-3 < offset[2] < LOWERED_M + 1e-3


def test_edges_of_the_view_move_on_their_own() -> None:
    views = [other_view(SMALL, rng(seed)) for seed in range(200)]
    up, down = (np.array([getattr(v, key) for v in views]) for key in ("fov_up", "fov_down"))
    for found, usual in ((up, SMALL.fov_up), (down, SMALL.fov_down)):
        assert np.abs(found - usual).max() <= EDGE_SHIFT_DEG
        assert np.ptp(found) > 1.8 * EDGE_SHIFT_DEG
    assert abs(np.corrcoef(up, down)[0, 1]) < 0.3


@pytest.mark.parametrize("seed", range(8))
def test_rows_are_kept_whole_or_left_out(seed: int) -> None:
    channels = project(make_scan(20_000), SMALL).channels
    found = fewer_beams(channels, rng(seed))
    same = [np.array_equal(found[:, row], channels[:, row]) for row in range(SMALL.height)]
    assert all(kept or not found[:, row].any() for row, kept in enumerate(same))
    low, high = other_sensors.LEAST_ROWS, other_sensors.MOST_ROWS
    assert low * SMALL.height <= sum(same) <= high * SMALL.height
    assert channels[0].any(axis=1).all()
