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
    AnnotatedScan,
    Checkerboard,
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


def annotated(seed: int, first: int = 0, count: int = 1500) -> AnnotatedScan:
    """Return a scan whose intensities number its points, and random labels."""
    numbers = np.arange(first, first + count, dtype=np.float32)
    labels = np.random.default_rng(seed).integers(0, 20, count).astype(np.uint8)
    return AnnotatedScan(Scan(make_scan(count, seed).points, numbers), labels)


def augmented(seed: int = 0, **probabilities: float) -> AnnotatedScan:
    recipe = NEVER.with_changes(**probabilities)
    return augment(annotated(0, count=500), recipe, np.random.default_rng(seed))


def test_shift_moves_all_points_alike_and_within_bounds() -> None:
    before = annotated(0, count=500).scan.points
    moved = [augmented(seed, shift=1.0).scan.points - before for seed in range(50)]
    for offsets in moved:
        np.testing.assert_allclose(offsets, np.broadcast_to(offsets[0], offsets.shape), atol=1e-5)
    first = np.array([offsets[0] for offsets in moved])
    assert (first >= [-5.001, -3.001, -1.001]).all()
    assert (first <= [5.001, 3.001, 0.001]).all()
    assert (np.ptp(first, axis=0) > [6, 4, 0.6]).all()


def test_flip_mirrors_left_and_right_and_points_without_a_measurement_stay_without():
    before = annotated(0, count=500).scan.points
    after = augmented(flip=1.0).scan.points
    np.testing.assert_array_equal(after, before * np.float32([1, -1, 1]))
    points = np.array([[0, 0, 0], [np.nan, 1, 1], [np.inf, 0, 0], [1, 2, 3]], np.float32)
    moved = rotate(shift(points, np.array([1.0, 2.0, -0.5])), 0.3)
    np.testing.assert_array_equal(moved[0], 0)
    assert not np.isfinite(moved[1:3]).all(axis=1).any()
    assert np.isfinite(moved[3]).all()


def test_dropping_is_without_replacement_and_points_have_their_labels() -> None:
    before = annotated(0, count=500)
    shares = []
    for seed in range(60):
        after = augmented(seed, drop=1.0)
        rest = after.scan.intensity.astype(int)  # the intensity numbers the points
        assert (np.diff(rest) > 0).all()  # in order, none twice
        np.testing.assert_array_equal(after.scan.points, before.scan.points[rest])
        np.testing.assert_array_equal(after.labels, before.labels[rest])
        shares.append(len(rest) / len(before.scan))
    assert 0.5 <= min(shares) < 0.56
    assert 0.94 < max(shares) <= 1


@pytest.mark.parametrize("count", [0, 1, 2])
def test_tiny_scans_survive_everything(count: int) -> None:
    scan = Scan(np.ones((count, 3), np.float32), np.ones(count, np.float32))
    always = Recipe(rotate=1.0, shift=1.0, flip=1.0, drop=1.0)
    before = AnnotatedScan(scan, np.ones(count, np.uint8))
    after = augment(before, always, np.random.default_rng(0))
    assert len(after.scan) == len(after.labels) == count


def is_mirrored(before: np.ndarray, after: np.ndarray) -> bool:
    """Return whether the linear map between points (N, 3), around their means, mirrors them."""
    centred_before = before - before.mean(axis=0)
    centred_after = after - after.mean(axis=0)
    linear_map, *_ = np.linalg.lstsq(centred_before, centred_after, rcond=None)
    return np.linalg.det(linear_map) < 0


def test_augmentations_are_independent_and_each_has_probability_half() -> None:
    """Published code nests them, so that most are rare, and never applies the rotation."""
    before = annotated(0, count=500)
    happened = []
    for seed in range(400):
        after = augment(before, Recipe(), np.random.default_rng(seed)).scan
        rest = after.intensity.astype(int)
        old = before.scan.points[rest]
        new = after.points
        height = new[:, 2].mean() - old[:, 2].mean()
        is_dropped = len(rest) < len(before.scan)
        is_shifted = abs(height) > 1e-4  # no other augmentation changes z
        happened.append((is_dropped, is_mirrored(old, new), is_shifted))
    shares = np.mean(happened, axis=0)
    assert (np.abs(shares - 0.5) < 0.08).all()
    assert (np.abs(np.corrcoef(np.transpose(happened)) - np.eye(3)) < 0.15).all()


# Mixing


def cell(point: np.ndarray, bands: int, sectors: int, azimuth: float) -> tuple[float, float]:
    """Return where a point lies, in bands from below and in sectors counter-clockwise.

    The lowest and the highest band reach beyond the field of view, so points there lie in their
    middle. The sector before the azimuth is number 0, the one that begins there number 1.
    """
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
    even = annotated(1, 0, 90)
    odd = annotated(2, 1000, 60)
    mixed = mix(even, odd, board)
    from_even = np.flatnonzero(~board.odd(even.scan.points))
    from_odd = np.flatnonzero(board.odd(odd.scan.points))
    count = len(from_even)
    np.testing.assert_array_equal(mixed.scan.intensity, [*from_even, *(1000 + from_odd)])
    np.testing.assert_array_equal(mixed.scan.points[:count], even.scan.points[from_even])
    np.testing.assert_array_equal(mixed.labels[:count], even.labels[from_even])
    np.testing.assert_array_equal(mixed.scan.points[count:], odd.scan.points[from_odd])
    np.testing.assert_array_equal(mixed.labels[count:], odd.labels[from_odd])


POINTLESS = np.float32(
    [[0, 0, 0], [np.nan, 1, 1], [1, np.inf, 0], [-np.inf, 1, 1], [3e38, 3e38, 3e38]]
)


def test_pasting_adds_the_points_turned_and_nothing_else() -> None:
    onto = annotated(1)
    other = annotated(2, 5000)
    is_clear = np.hypot(*other.scan.points.T[:2]) > CLEAR_RADIUS_M
    rare = select(other, (other.labels == 6) & is_clear)
    angles = np.array([0.7, -2.0, 3.0])
    pasted = paste(onto, rare, angles)
    scan = pasted.scan
    labels = pasted.labels
    count = len(rare.scan)
    assert count > 20
    assert len(scan) == len(labels) == len(onto.scan) + 3 * count
    np.testing.assert_array_equal(scan.points[:1500], onto.scan.points)
    np.testing.assert_array_equal(scan.intensity[:1500], onto.scan.intensity)
    np.testing.assert_array_equal(labels[:1500], onto.labels)
    before = rare.scan.points.astype(float)
    for copy, angle in enumerate(angles):
        here = slice(1500 + copy * count, 1500 + (copy + 1) * count)
        after = scan.points[here].astype(float)
        np.testing.assert_array_equal(after[:, 2], before[:, 2])
        np.testing.assert_allclose(np.hypot(*after.T[:2]), np.hypot(*before.T[:2]), rtol=1e-6)
        # As unit vectors, since a difference of angles may be off by whole turns.
        turned = np.arctan2(after[:, 1], after[:, 0]) - np.arctan2(before[:, 1], before[:, 0])
        np.testing.assert_allclose(np.exp(1j * turned), np.exp(1j * angle), atol=1e-5)
        np.testing.assert_array_equal(scan.intensity[here], rare.scan.intensity)
        assert set(labels[here]) == {6}


def test_nothing_is_pasted_on_the_sensor_or_without_a_measurement() -> None:
    near = np.float32([[0.9 * CLEAR_RADIUS_M, 0, -1], [0, 0, 5], [1.1 * CLEAR_RADIUS_M, 0, -1]])
    points = np.concatenate([POINTLESS[:4], near])
    broken = AnnotatedScan(Scan(points, np.ones(7, np.float32)), np.full(7, 6, np.uint8))
    pasted = paste(annotated(1), broken, np.array([1.0, 2.0]))
    # Only the last point is pasted, at two angles.
    assert len(pasted.labels) == 1500 + 2
    distances = np.hypot(*pasted.scan.points[1500:].T[:2])
    np.testing.assert_allclose(distances, 1.1 * CLEAR_RADIUS_M, rtol=1e-5)


# Windows

SCORED = label_space().scored


def test_windows_on_a_class_hold_rare_ones_as_often_as_common_ones() -> None:
    truth = np.full((4, 512), 9, np.uint8)
    truth[2, 100] = 6  # one pixel of person
    truth[:, 300] = 0  # unlabelled, never aimed at
    random = np.random.default_rng(0)
    # Half the windows aim at road, and hold the person by chance.
    holds = [6 in truth[:, choose_columns(truth, SCORED, 32, 1.0, random)] for _ in range(1000)]
    assert np.mean(holds) == pytest.approx(0.5 + 0.5 * 32 / 512, abs=0.05)
    assert len(choose_columns(0 * truth, SCORED, 16, 1.0, random)) == 16
