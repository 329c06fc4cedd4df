# SPDX-License-Identifier: MIT
import numpy as np
import pytest

from salsanext_cli.records import Scan
from salsanext_cli.training.augment import augment, rotate, shift
from salsanext_cli.training.recipe import Recipe

NEVER = Recipe(rotate=0.0, shift=0.0, flip=0.0, drop=0.0)


def cloud(count: int = 500) -> tuple[Scan, np.ndarray]:
    random = np.random.default_rng(0)
    points = random.normal(0, 10, (count, 3)).astype(np.float32)
    return Scan(points, np.arange(count, dtype=np.float32)), (np.arange(count) % 20).astype(
        np.uint8
    )


def augmented(seed: int = 0, **probabilities: float) -> tuple[Scan, np.ndarray]:
    return augment(cloud(), NEVER.with_changes(**probabilities), np.random.default_rng(seed))


def test_nothing_happens_with_probability_zero() -> None:
    scan, labels = augmented()
    np.testing.assert_array_equal(scan.points, cloud()[0].points)
    np.testing.assert_array_equal(labels, cloud()[1])


def test_rotation_is_counter_clockwise() -> None:
    turned = rotate(np.array([[1, 0, 3], [0, 2, -1]], np.float32), np.pi / 2)
    np.testing.assert_allclose(turned, [[0, 1, 3], [-2, 0, -1]], atol=1e-6)


def test_rotation_angles_cover_the_whole_circle() -> None:
    ahead = (
        Scan(np.array([[1, 0, 0]], np.float32), np.zeros(1, np.float32)),
        np.zeros(1, np.uint8),
    )
    always = NEVER.with_changes(rotate=1.0)
    turned = [augment(ahead, always, np.random.default_rng(i))[0].points[0] for i in range(400)]
    angles = np.arctan2(*np.transpose(turned)[[1, 0]])
    counts, _ = np.histogram(angles, bins=8, range=(-np.pi, np.pi))
    assert counts.min() > 25


def test_shift_moves_all_points_alike_and_within_bounds() -> None:
    moved = [augmented(seed, shift=1.0)[0].points - cloud()[0].points for seed in range(50)]
    for offsets in moved:
        np.testing.assert_allclose(offsets, np.broadcast_to(offsets[0], offsets.shape), atol=1e-5)
    first = np.array([offsets[0] for offsets in moved])
    assert (first >= [-5.001, -3.001, -1.001]).all()
    assert (first <= [5.001, 3.001, 0.001]).all()
    assert (np.ptp(first, axis=0) > [6, 4, 0.6]).all()


def test_points_without_a_measurement_stay_without() -> None:
    points = np.array([[0, 0, 0], [np.nan, 1, 1], [np.inf, 0, 0], [1, 2, 3]], np.float32)
    moved = rotate(shift(points, np.array([1.0, 2.0, -0.5])), 0.3)
    np.testing.assert_array_equal(moved[0], 0)
    assert not np.isfinite(moved[1:3]).all(axis=1).any()
    assert np.isfinite(moved[3]).all()


def test_flip_mirrors_left_and_right() -> None:
    after = augmented(flip=1.0)[0].points
    np.testing.assert_array_equal(after, cloud()[0].points * np.float32([1, -1, 1]))


def test_dropping_is_without_replacement_and_keeps_points_with_their_labels() -> None:
    before, labels_before = cloud()
    shares = []
    for seed in range(60):
        scan, labels = augmented(seed, drop=1.0)
        kept = scan.intensity.astype(int)  # the intensity numbers the points
        assert (np.diff(kept) > 0).all()  # in order, none twice
        np.testing.assert_array_equal(scan.points, before.points[kept])
        np.testing.assert_array_equal(labels, labels_before[kept])
        shares.append(len(kept) / len(before))
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
    before = cloud()[0]
    happened = []
    for seed in range(400):
        after, _ = augment(cloud(), Recipe(), np.random.default_rng(seed))
        kept = after.intensity.astype(int)
        old, new = before.points[kept], after.points
        handed = np.linalg.det(np.linalg.lstsq(old - old.mean(0), new - new.mean(0))[0])
        offset = new.mean(0) - old.mean(0)
        happened.append((len(kept) < len(before), handed < 0, abs(offset[2]) > 1e-4))
    shares = np.mean(happened, axis=0)
    assert (np.abs(shares - 0.5) < 0.08).all()
    assert (np.abs(np.corrcoef(np.transpose(happened)) - np.eye(3)) < 0.15).all()
