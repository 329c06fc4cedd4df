# SPDX-License-Identifier: MIT
"""Changes of samples: moved, mixed, pasted, and as measured by other sensors."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scans import SMALL, make_scan

from salsanext_cli import Scan, label_space
from salsanext_cli.training.data.augment import (
    CLEAR_RADIUS_M,
    Checkerboard,
    LabelledScan,
    augment,
    choose_columns,
    mix,
    paste,
    rotate,
    select,
    shift,
)
from salsanext_cli.training.recipe import Recipe

BOARDS = [(4, 1), (6, 1), (1, 2), (1, 6), (2, 2), (3, 4), (5, 6)]
DOWN, UP = SMALL.fov_down, SMALL.fov_up
NEVER = Recipe(rotate=0.0, shift=0.0, flip=0.0, drop=0.0)


def labelled(seed: int, first: int = 0, count: int = 1500) -> LabelledScan:
    """Return a scan whose intensities number its points, and random labels."""
    numbers = np.arange(first, first + count, dtype=np.float32)
    labels = np.random.default_rng(seed).integers(0, 20, count).astype(np.uint8)
    return Scan(make_scan(count, seed).points, numbers), labels


def augmented(seed: int = 0, **probabilities: float) -> LabelledScan:
    recipe = NEVER.with_changes(**probabilities)
    return augment(labelled(0, count=500), recipe, np.random.default_rng(seed))


def test_shift_moves_all_points_alike_and_within_bounds() -> None:
    before = labelled(0, count=500)[0].points
    moved = [augmented(seed, shift=1.0)[0].points - before for seed in range(50)]
    for offsets in moved:
        np.testing.assert_allclose(offsets, np.broadcast_to(offsets[0], offsets.shape), atol=1e-5)
    first = np.array([offsets[0] for offsets in moved])
    assert (first >= [-5.001, -3.001, -1.001]).all()
    assert (first <= [5.001, 3.001, 0.001]).all()
    assert (np.ptp(first, axis=0) > [6, 4, 0.6]).all()


def test_flip_mirrors_left_and_right_and_points_without_a_measurement_stay_without():
    after = augmented(flip=1.0)[0].points
    np.testing.assert_array_equal(after, labelled(0, count=500)[0].points * np.float32([1, -1, 1]))
    points = np.array([[0, 0, 0], [np.nan, 1, 1], [np.inf, 0, 0], [1, 2, 3]], np.float32)
    moved = rotate(shift(points, np.array([1.0, 2.0, -0.5])), 0.3)
    np.testing.assert_array_equal(moved[0], 0)
    assert not np.isfinite(moved[1:3]).all(axis=1).any()
    assert np.isfinite(moved[3]).all()


def test_dropping_is_without_replacement_and_points_have_their_labels() -> None:
    before, labels_before = labelled(0, count=500)
    shares = []
    for seed in range(60):
        scan, labels = augmented(seed, drop=1.0)
        rest = scan.intensity.astype(int)  # the intensity numbers the points
        assert (np.diff(rest) > 0).all()  # in order, none twice
        np.testing.assert_array_equal(scan.points, before.points[rest])
        np.testing.assert_array_equal(labels, labels_before[rest])
        shares.append(len(rest) / len(before))
    assert 0.5 <= min(shares) < 0.56
    assert 0.94 < max(shares) <= 1


@pytest.mark.parametrize("count", [0, 1, 2])
def test_tiny_scans_survive_everything(count: int) -> None:
    scan = Scan(np.ones((count, 3), np.float32), np.ones(count, np.float32))
    always = Recipe(rotate=1.0, shift=1.0, flip=1.0, drop=1.0)
    after, labels = augment((scan, np.ones(count, np.uint8)), always, np.random.default_rng(0))
    assert len(after) == len(labels) == count


def test_each_happens_on_its_own_half_of_the_time() -> None:
    """Published code nests them, so that most are rare, and never applies the rotation."""
    before = labelled(0, count=500)[0]
    happened = []
    for seed in range(400):
        after, _ = augment(labelled(0, count=500), Recipe(), np.random.default_rng(seed))
        rest = after.intensity.astype(int)
        old, new = before.points[rest], after.points
        handed = np.linalg.det(np.linalg.lstsq(old - old.mean(0), new - new.mean(0), rcond=None)[0])
        offset = new.mean(0) - old.mean(0)
        happened.append((len(rest) < len(before), handed < 0, abs(offset[2]) > 1e-4))
    shares = np.mean(happened, axis=0)
    assert (np.abs(shares - 0.5) < 0.08).all()
    assert (np.abs(np.corrcoef(np.transpose(happened)) - np.eye(3)) < 0.15).all()


# Mixing


def cell(point: np.ndarray, bands: int, sectors: int, azimuth: float) -> tuple[float, float]:
    """Return where a point lies, in bands from below and in sectors counter-clockwise."""
    x, y, z = map(float, point)
    inclination = math.degrees(math.atan2(z, math.hypot(x, y)))
    band = (inclination - DOWN) / (UP - DOWN) * bands
    turned = (math.atan2(y, x) - azimuth) % (2 * math.pi)
    return min(max(band, 0.5), bands - 0.5), turned / (2 * math.pi) * sectors + 1


def by_cells(scan: Scan, bands: int, sectors: int, azimuth: float) -> list[bool | None]:
    """Return slowly whether points lie in odd cells; None too near to a border."""
    odd: list[bool | None] = []
    for point in scan.points:
        places = cell(point, bands, sectors, azimuth)
        parts = zip((bands, sectors), places, strict=True)
        unsure = any(n > 1 and abs(p - round(p)) < 1e-4 for n, p in parts)
        row, column = math.floor(places[0]), math.floor(places[1]) % sectors
        odd.append(None if unsure else (row + column) % 2 == 1)
    return odd


@pytest.mark.parametrize(("bands", "sectors"), BOARDS)
@pytest.mark.parametrize("azimuth", [0.0, 2.3, -3.1])
def test_odd_points_lie_in_odd_cells(bands: int, sectors: int, azimuth: float) -> None:
    scan = make_scan(800, bands)
    odd = Checkerboard(bands=bands, sectors=sectors, azimuth=azimuth, fov_down=DOWN, fov_up=UP).odd(
        scan.points
    )
    expected = by_cells(scan, bands, sectors, azimuth)
    sure = np.array([each is not None for each in expected])
    assert sure.mean() > 0.98
    np.testing.assert_array_equal(odd[sure], np.array(expected)[sure].astype(bool))
    assert 0.1 < odd.mean() < 0.9


@given(st.integers(0, 2**32 - 1))
def test_every_point_comes_from_the_scan_of_its_cell_and_keeps_its_label(seed: int) -> None:
    board = Checkerboard.random(SMALL, np.random.default_rng(seed))
    sources = (labelled(1, 0, 90), labelled(2, 1000, 60))
    scan, labels = mix(*sources, board)
    odd = [board.odd(source.points) for source, _ in sources]
    taken = [np.flatnonzero(~odd[0]), np.flatnonzero(odd[1])]
    np.testing.assert_array_equal(scan.intensity, [*taken[0], *(1000 + taken[1])])
    for part, (source, truth), index in zip((0, 1), sources, taken, strict=True):
        here = slice(0, len(taken[0])) if part == 0 else slice(len(taken[0]), None)
        np.testing.assert_array_equal(scan.points[here], source.points[index])
        np.testing.assert_array_equal(labels[here], truth[index])


POINTLESS = np.float32(
    [[0, 0, 0], [np.nan, 1, 1], [1, np.inf, 0], [-np.inf, 1, 1], [3e38, 3e38, 3e38]]
)


def test_pasting_adds_the_points_turned_and_nothing_else() -> None:
    onto, other = labelled(1), labelled(2, 5000)
    rare = select(other, (other[1] == 6) & (np.hypot(*other[0].points.T[:2]) > CLEAR_RADIUS_M))
    angles = np.array([0.7, -2.0, 3.0])
    scan, labels = paste(onto, rare, angles)
    count = len(rare[0])
    assert count > 20
    assert len(scan) == len(labels) == len(onto[0]) + 3 * count
    np.testing.assert_array_equal(scan.points[:1500], onto[0].points)
    np.testing.assert_array_equal(scan.intensity[:1500], onto[0].intensity)
    np.testing.assert_array_equal(labels[:1500], onto[1])
    before = rare[0].points.astype(float)
    for copy, angle in enumerate(angles):
        here = slice(1500 + copy * count, 1500 + (copy + 1) * count)
        after = scan.points[here].astype(float)
        np.testing.assert_array_equal(after[:, 2], before[:, 2])
        np.testing.assert_allclose(np.hypot(*after.T[:2]), np.hypot(*before.T[:2]), rtol=1e-6)
        turned = np.arctan2(after[:, 1], after[:, 0]) - np.arctan2(before[:, 1], before[:, 0])
        np.testing.assert_allclose(np.exp(1j * turned), np.exp(1j * angle), atol=1e-5)
        np.testing.assert_array_equal(scan.intensity[here], rare[0].intensity)
        assert set(labels[here]) == {6}


def test_nothing_is_pasted_on_the_sensor_or_without_a_measurement() -> None:
    near = np.float32([[0.9 * CLEAR_RADIUS_M, 0, -1], [0, 0, 5], [1.1 * CLEAR_RADIUS_M, 0, -1]])
    points = np.concatenate([POINTLESS[:4], near])
    broken = (Scan(points, np.ones(7, np.float32)), np.full(7, 6, np.uint8))
    scan, labels = paste(labelled(1), broken, np.array([1.0, 2.0]))
    assert len(labels) == 1500 + 2
    np.testing.assert_allclose(np.hypot(*scan.points[1500:].T[:2]), 1.1 * CLEAR_RADIUS_M, rtol=1e-5)


# Windows

SCORED = label_space().scored


def test_windows_on_a_class_hold_rare_ones_as_often_as_common_ones() -> None:
    truth = np.full((4, 512), 9, np.uint8)
    truth[2, 100] = 6  # one pixel of person
    truth[:, 300] = 0  # unlabelled, never aimed at
    random = np.random.default_rng(0)
    holds = [6 in truth[:, choose_columns(truth, SCORED, 32, 1.0, random)] for _ in range(1000)]
    assert np.mean(holds) == pytest.approx(0.5 + 0.5 * 32 / 512, abs=0.05)
    assert len(choose_columns(0 * truth, SCORED, 16, 1.0, random)) == 16
