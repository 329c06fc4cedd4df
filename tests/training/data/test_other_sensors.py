# SPDX-License-Identifier: MIT
"""Changes that imitate other sensors."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scans import SMALL, make_scan

from salsanext_cli import project
from salsanext_cli.training.data import other_sensors

SEEDS = st.integers(0, 999)


def rng(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed)


@given(SEEDS, st.sampled_from([1.0, 0.6, 255.0]))
def test_intensities_follow_one_law_of_intensity_and_range(seed: int, bright: float) -> None:
    """On any scale."""
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
    changed = other_sensors.change_intensity(scan, bright, rng(seed))
    np.testing.assert_allclose(changed.intensity, expected, rtol=1e-4, atol=1e-5 * bright)
    np.testing.assert_array_equal(changed.points, scan.points)


@given(SEEDS)
def test_another_mounting_is_a_small_rotation_and_a_shift_up_or_down(seed: int) -> None:
    points = make_scan(50, seed).points
    other = other_sensors.mount_otherwise(points, rng(seed)).astype(float)
    centred, moved = points - points.mean(axis=0), other - other.mean(axis=0)
    turn = np.linalg.lstsq(centred, moved, rcond=None)[0].T
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-4)
    assert np.linalg.det(turn) == pytest.approx(1, abs=1e-4)
    assert np.degrees(np.arccos(min(1, turn[2, 2]))) < 5
    # The axis is level: nothing turns about z.
    assert turn[0, 1] - turn[1, 0] == pytest.approx(0, abs=1e-4)
    offset = other.mean(axis=0) - turn @ points.mean(axis=0)
    np.testing.assert_allclose(offset[:2], 0, atol=1e-3)
    assert -other_sensors.RAISED_M - 1e-3 < offset[2] < other_sensors.LOWERED_M + 1e-3


def test_edges_of_the_field_of_view_move_independently() -> None:
    views = [other_sensors.other_view(SMALL, rng(seed)) for seed in range(200)]
    up, down = (np.array([getattr(v, key) for v in views]) for key in ("fov_up", "fov_down"))
    for edges, usual in ((up, SMALL.fov_up), (down, SMALL.fov_down)):
        assert np.abs(edges - usual).max() <= other_sensors.EDGE_SHIFT_DEG
        assert np.ptp(edges) > 1.8 * other_sensors.EDGE_SHIFT_DEG
    assert abs(np.corrcoef(up, down)[0, 1]) < 0.3


@pytest.mark.parametrize("seed", range(8))
def test_rows_are_unchanged_or_empty(seed: int) -> None:
    channels = project(make_scan(20_000), SMALL).channels
    thinned = other_sensors.fewer_beams(channels, rng(seed))
    same = [np.array_equal(thinned[:, row], channels[:, row]) for row in range(SMALL.height)]
    assert all(is_same or not thinned[:, row].any() for row, is_same in enumerate(same))
    low, high = other_sensors.MIN_ROWS, other_sensors.MAX_ROWS
    assert low * SMALL.height <= sum(same) <= high * SMALL.height
    assert channels[0].any(axis=1).all()


# Holes and noise of positions


def image(seed: int, shape: tuple[int, int] = (6, 40), empty: float = 0.5) -> np.ndarray:
    """Return ranges with steps, some of them empty."""
    random = rng(seed)
    ranges = random.choice([3.0, 3.2, 7.0, 15.0, 30.0, 60.0, 90.0], shape).astype(np.float32)
    return np.where(random.random(shape) < empty, np.float32(0), ranges)


def cell_by_walking(row: list[float], column: int) -> int:
    """Return the cell of a pixel: walk from it both ways round the circle."""
    sides = []
    for way in (-1, 1):
        for step in range(1, other_sensors.MAX_RUN + 1):
            if there := row[(column + way * step) % len(row)]:
                sides.append((there, step))
                break
    if len(sides) < 2 or sides[0][1] + sides[1][1] - 1 > other_sensors.MAX_RUN:
        return -1
    near, far = sorted(value for value, _ in sides)
    kind = int(far / near > other_sensors.EDGE_RATIO)
    place = sum(near >= edge for edge in other_sensors.RANGE_EDGES_M)
    return kind * other_sensors.HOLE_SHARES.shape[1] + place


@pytest.mark.parametrize("seed", range(5))
def test_cells_depend_on_the_next_measured_pixels(seed: int) -> None:
    ranges = image(seed)
    wanted = [[cell_by_walking(row, k) for k in range(len(row))] for row in ranges.tolist()]
    np.testing.assert_array_equal(other_sensors.hole_cells(ranges), wanted)


def test_pixels_are_lost_with_the_share_of_their_cell() -> None:
    channels = np.stack([image(1, (64, 512), 0.1), np.full((64, 512), 7, np.float32)])
    before, cells = channels.copy(), other_sensors.hole_cells(channels[0])
    for seed in range(12):
        factor = rng(seed).uniform(0, other_sensors.MAX_HOLES)
        holed = other_sensors.make_holes(channels, rng(seed))
        lost = holed[1] == 0
        np.testing.assert_array_equal(holed, np.where(lost, 0, before))
        assert holed.dtype == np.float32
        assert not lost[cells < 0].any()
        for cell, share in enumerate(other_sensors.HOLE_SHARES.ravel()):
            of_cell, wanted = lost[cells == cell], factor * share
            # Runs make the mean vary as that of fewer pixels would.
            spread = 5 * np.sqrt(2.5 * wanted / len(of_cell))
            assert of_cell.mean() == pytest.approx(wanted, abs=spread)
    np.testing.assert_array_equal(channels, before)


def test_holes_of_one_surface_come_in_runs() -> None:
    """The next pixel is lost with this one, or by chance."""
    assert other_sensors.lose_pixels(np.full((1, 8, 64), 7, np.float32), 0.0, rng(0)).all()
    lost = other_sensors.lose_pixels(np.full((1, 400, 512), 7, np.float32), 2.4, rng(5))[0] == 0
    going_on = lost[:, 1:][lost[:, :-1]].mean()
    share = other_sensors.CONTINUED
    assert going_on == pytest.approx(share + (1 - share) * lost.mean(), abs=0.02)


@pytest.mark.parametrize("seed", range(4))
def test_jitter_is_normal_noise_on_measured_points(seed: int) -> None:
    points = np.full((20_000, 3), 9, np.float32)
    points[:3] = [[0, 0, 0], [np.nan, 1, 1], [np.inf, 0, 0]]
    moved = other_sensors.jitter(points, rng(seed))
    assert moved.dtype == np.float32
    assert not moved[0].any()
    assert not np.isfinite(moved[1:3]).all(axis=1).any()
    offset = moved[3:].astype(float) - 9
    wanted = rng(seed).uniform(0, other_sensors.MAX_JITTER_M)
    np.testing.assert_allclose(offset.std(axis=0), wanted, rtol=0.05)
    np.testing.assert_allclose(offset.mean(axis=0), 0, atol=0.05 * other_sensors.MAX_JITTER_M)
    assert abs(np.corrcoef(offset.T) - np.eye(3)).max() < 0.05
    assert (np.abs(offset) < 2 * wanted).mean() == pytest.approx(0.954, abs=0.01)
