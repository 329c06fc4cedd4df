# SPDX-License-Identifier: MIT
"""Motions of the scans of a batch, beside those of one scan on the CPU."""

import math

import numpy as np
import pytest
import torch
from scan_stores import CPU, batch_random, stored
from scans import make_scan

from salsanext_cli import Scan
from salsanext_cli.training.data import augment as one_scan
from salsanext_cli.training.data import other_sensors
from salsanext_cli.training.data.on_device.motion import (
    augment,
    change_intensity,
    mapped,
    tilts,
    turns,
)
from salsanext_cli.training.data.on_device.point_batch import PointBatch
from salsanext_cli.training.recipe import Recipe

NEVER = Recipe(rotate=0.0, shift=0.0, flip=0.0, drop=0.0)


def batch_of(*seeds: int, count: int = 300) -> PointBatch:
    return PointBatch.from_scans([stored(make_scan(count, seed)) for seed in seeds], CPU)


def test_turns_are_those_of_one_scan() -> None:
    batch = batch_of(0, 1)
    angles = np.array([0.7, -2.9])
    offset = torch.tensor([[0.0, 0.0, 0.0], [1.0, -2.0, 3.0]])
    points = mapped(batch, torch.from_numpy(turns(angles)).float(), offset)
    for number, angle in enumerate(angles):
        is_scan = batch.scan_of_point == number
        expected = one_scan.rotate(batch.points[is_scan].numpy(), angle) + offset[number].numpy()
        np.testing.assert_allclose(points[is_scan], expected, atol=1e-5)


def test_tilts_are_rotations_about_level_axes() -> None:
    angles = np.array([0.02, -0.05, 0.3])
    azimuths = np.array([0.0, 1.1, 4.0])
    for turn, angle, azimuth in zip(tilts(angles, azimuths), angles, azimuths, strict=True):
        axis = np.array([math.cos(azimuth), math.sin(azimuth), 0])
        cross = np.cross(np.eye(3), axis)
        expected = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
        np.testing.assert_allclose(turn, expected.T, atol=1e-12)


@pytest.mark.parametrize("key", ["rotate", "shift", "flip", "mount", "jitter", "drop"])
def test_a_chance_of_zero_changes_nothing_and_one_changes_every_scan(key: str) -> None:
    batch = batch_of(0, 1, 2)
    random = batch_random()
    same = augment(batch, 3, NEVER, random)
    assert torch.equal(same.points, batch.points)
    assert same.is_shown.all()
    other = augment(batch, 3, NEVER.with_changes(**{key: 1.0}), random)
    for number in range(3):
        is_scan = batch.scan_of_point == number
        is_moved = not torch.equal(other.points[is_scan], batch.points[is_scan])
        is_thinned = not other.is_shown[is_scan].all()
        assert (is_moved, is_thinned) == (key != "drop", key == "drop")
    assert torch.equal(other.targets, batch.targets)


def test_all_motions_together_are_those_of_one_scan_in_their_order() -> None:
    """The map between the points has the parts of the CPU: turn, shift, flip, mount."""
    batch = batch_of(0)
    always = NEVER.with_changes(rotate=1.0, shift=1.0, flip=1.0, mount=1.0)
    random = batch_random(3)
    moved = augment(batch, 1, always, random).points.double().numpy()
    drawn = batch_random(3).host
    angle = drawn.uniform(-np.pi, np.pi, 1)
    drawn.random(1)
    offset = drawn.uniform(one_scan.SHIFT_LOW_M, one_scan.SHIFT_HIGH_M, (1, 3))
    drawn.random(3)  # Of shift, flip and mount
    tilt = np.radians(drawn.normal(0, other_sensors.TILT_DEG, 1))
    azimuth = drawn.uniform(0, 2 * np.pi, 1)
    raised = drawn.uniform(-other_sensors.RAISED_M, other_sensors.LOWERED_M, 1)
    expected = one_scan.rotate(batch.points.numpy(), angle[0])
    expected = one_scan.shift(expected, offset[0]) * np.float32([1, -1, 1])
    expected = expected @ tilts(tilt, azimuth)[0] + [0, 0, raised[0]]
    np.testing.assert_allclose(moved, expected, atol=1e-4)


def test_dropping_hides_the_drawn_share_of_the_points_of_each_scan() -> None:
    batch = batch_of(*range(8), count=4000)
    random = batch_random(5)
    dropped = augment(batch, 8, NEVER.with_changes(drop=1.0), random)
    share = batch_random(5).host.uniform(0, one_scan.MAX_DROPPED_SHARE, 8)
    for number in range(8):
        hidden = (~dropped.is_shown[batch.scan_of_point == number]).float().mean().item()
        assert hidden == pytest.approx(share[number], abs=5 * math.sqrt(0.25 / 4000))


def test_jitter_is_normal_noise() -> None:
    batch = batch_of(0, 1, count=20_000)
    moved = augment(batch, 2, NEVER.with_changes(jitter=1.0), batch_random(2))
    wanted = batch_random(2).host.uniform(0, other_sensors.MAX_JITTER_M, 2)
    for number, deviation in enumerate(wanted):
        is_scan = batch.scan_of_point == number
        offset = (moved.points - batch.points)[is_scan].numpy()
        np.testing.assert_allclose(offset.std(axis=0), deviation, rtol=0.05, atol=1e-5)
        assert abs(np.corrcoef(offset.T) - np.eye(3)).max() < 0.05


@pytest.mark.parametrize("bright", [1.0, 255.0])
def test_intensities_follow_the_law_of_the_cpu(bright: float) -> None:
    scan = make_scan(400)
    scan = Scan(scan.points, scan.intensity * np.float32(bright))
    batch = PointBatch.from_scans([stored(scan), stored(scan)], CPU)
    changed = change_intensity(batch, 2, bright, 1.0, batch_random(4))
    drawn = batch_random(4).host
    gain, gamma = np.exp(drawn.normal(0, [[0.3], [0.3]], (2, 2)))
    power, offset = drawn.normal(0, [[0.15], [0.05]], (2, 2))
    ranges = batch.points[:400].double().norm(dim=1).numpy() / 10
    values = batch.intensity[:400].double().numpy() / bright
    for number in range(2):
        law = gain[number] * values ** gamma[number] * ranges ** power[number] + offset[number]
        found = changed.intensity[changed.scan_of_point == number]
        np.testing.assert_allclose(found, bright * law, rtol=1e-4, atol=1e-5 * bright)
    assert change_intensity(batch, 2, bright, 0.0, batch_random()) is batch


def test_points_without_a_measurement_are_never_shown() -> None:
    scan = make_scan(50)
    scan.points[:4] = [[0, 0, 0], [np.nan, 1, 1], [np.inf, 0, 0], [1e6, 0, 0]]
    always = Recipe(rotate=1.0, shift=1.0, flip=1.0, drop=0.0, mount=1.0, jitter=1.0)
    batch = PointBatch.from_scans([stored(scan)], CPU)
    for changed in (batch, augment(batch, 1, always, batch_random())):
        assert changed.is_shown.tolist() == 4 * [False] + 46 * [True]
