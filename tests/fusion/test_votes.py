# SPDX-License-Identifier: MIT
from collections import defaultdict

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from salsanext_cli import Scan, label_space
from salsanext_cli.fusion.top_classes import KEPT, LEVELS, softmax_of, top_classes
from salsanext_cli.fusion.votes import SCALE, VOXEL_SIZES_M
from salsanext_cli.fusion.window import disagreement, fuse, fused_labels, movable_classes
from salsanext_cli.options import FusionReach

CLASSES = 20
CAR, PERSON, ROAD = 1, 6, 9


def drive(seed, scans=5, points=60, extent=1.5):
    """Return points in the frames of moving and turning scans, softmax of them, and poses."""
    random = np.random.default_rng(seed)
    poses = np.tile(np.eye(4), (scans, 1, 1))
    for number, pose in enumerate(poses):
        turn = 0.1 * number
        pose[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
        pose[:3, 3] = [0.2 * number, -0.1 * number, 0]
    of_scans, softmax = [], []
    for pose in poses:
        world = random.uniform(-extent, extent, (points, 3))
        own = (world - pose[:3, 3]) @ pose[:3, :3]
        of_scans.append(Scan(own.astype(np.float32), np.zeros(points, np.float32)))
        of_points = random.dirichlet(np.full(CLASSES, 0.3), points).astype(np.float32)
        of_points[random.random(points) < 0.1] = np.eye(CLASSES)[0]
        softmax.append(of_points)
    return of_scans, softmax, poses


def slowly(scans, softmax, poses, reach, movable):
    """Add up votes in dictionaries."""
    results = []
    for index in range(len(scans)):
        shares = np.zeros((len(VOXEL_SIZES_M), len(scans[index].points), CLASSES))
        for which, size in enumerate(VOXEL_SIZES_M):
            views = []
            for scan, of_points, pose in zip(scans, softmax, poses, strict=True):
                voxels = defaultdict(list)
                world = scan.points.astype(float) @ pose[:3, :3].T + pose[:3, 3]
                for place, probabilities in zip(world, of_points, strict=True):
                    if probabilities[0] < 1:
                        voxels[tuple(np.floor(place / size))].append(probabilities)
                views.append({voxel: np.mean(all_, axis=0) for voxel, all_ in voxels.items()})
            world = scans[index].points.astype(float) @ poses[index][:3, :3].T + poses[index][:3, 3]
            seen = np.zeros(len(world), int)
            for number, place in enumerate(world):
                voxel = tuple(np.floor(place / size))
                if softmax[index][number, 0] == 1:
                    continue
                total, counts = np.zeros(CLASSES), np.zeros(CLASSES)
                for other, view in enumerate(views):
                    away = abs(other - index)
                    if away <= reach.reach and voxel in view:
                        counted = (away <= reach.movable_reach) | ~movable
                        total += view[voxel] * counted
                        counts += counted
                        seen[number] += 1
                shares[which, number] = total / counts
                shares[which, number] /= shares[which, number].sum()
        results.append((shares.mean(axis=0), seen))
    return results


@given(st.integers(0, 10_000), st.integers(0, 4), st.integers(0, 4))
def test_votes_are_those_of_a_slow_loop(seed, reach, movable_reach):
    scans, softmax, poses = drive(seed)
    settings = FusionReach(reach, min(reach, movable_reach))
    movable = movable_classes(label_space())
    expected = slowly(scans, softmax, poses, settings, movable)
    for tally, (shares, views) in zip(fuse(scans, softmax, poses, settings), expected, strict=True):
        np.testing.assert_array_equal(tally.views, views)
        # Each probability of a vote is rounded by half a step, and their sum by one per class.
        rounding = (1 + CLASSES) / 2 / SCALE
        np.testing.assert_allclose(tally.probabilities, shares, atol=rounding)


def test_a_place_in_another_part_of_the_drive_has_no_vote():
    scans, softmax, poses = drive(0)
    poses[3:, 0, 3] += 1000
    tallies = fuse(scans, softmax, poses)
    alone = fuse(scans[:3], softmax[:3], poses[:3])
    np.testing.assert_array_equal(tallies[2].probabilities, alone[2].probabilities)
    assert max(tally.views.max() for tally in tallies[3:]) <= 2


def test_a_label_changes_only_where_another_scan_sees_the_place():
    place = np.float32([[0.1, 0.1, 0.1], [5, 5, 5]])
    scans = [Scan(place[:count], np.zeros(count, np.float32)) for count in (2, 1, 1)]
    road, car = np.eye(CLASSES, dtype=np.float32)[[ROAD, CAR]]
    labels = np.uint8([CAR, CAR])
    tally = fuse(scans, [[car, road], [road], [road]], np.tile(np.eye(4), (3, 1, 1)))[0]
    assert fused_labels(tally, labels).tolist() == [ROAD, CAR]
    np.testing.assert_allclose(disagreement(tally, labels), [2 / 3, 1], atol=1e-4)


def test_scans_too_far_away_to_speak_of_cars_are_not_against_them():
    scan = Scan(np.zeros((1, 3), np.float32), np.zeros(1, np.float32))
    softmax = np.zeros((1, CLASSES), np.float32)
    softmax[0, [CAR, ROAD]] = 0.8, 0.2
    tallies = fuse([scan] * 41, [softmax] * 41, np.tile(np.eye(4), (41, 1, 1)))
    np.testing.assert_allclose(tallies[20].probabilities, softmax, atol=1e-3)
    assert tallies[20].views.tolist() == [41]


def test_points_without_a_label_neither_vote_nor_are_judged():
    scan = Scan(np.zeros((2, 3), np.float32), np.zeros(2, np.float32))
    softmax = np.eye(CLASSES, dtype=np.float32)[[0, ROAD]]
    tally = fuse([scan], [softmax], np.eye(4)[None])[0]
    assert tally.views.tolist() == [0, 1]
    assert np.isnan(disagreement(tally, np.uint8([0, ROAD]))).tolist() == [True, False]
    assert fused_labels(tally, np.uint8([0, ROAD])).tolist() == [0, ROAD]


@pytest.mark.parametrize(
    ("name", "expected"), [("semantic-kitti", range(1, 9)), ("coarse", (1, 2))]
)
def test_what_may_move_is_told_by_the_names(name, expected):
    assert np.flatnonzero(movable_classes(label_space(name))).tolist() == list(expected)


@given(st.integers(0, 10_000), st.integers(2, CLASSES))
def test_kept_classes_are_the_most_probable(seed, classes):
    softmax = np.random.default_rng(seed).dirichlet(np.full(classes, 0.4), 50).astype(np.float32)
    kept = softmax_of(top_classes(softmax), classes)
    assert ((kept > 0).sum(axis=1) <= KEPT).all()
    largest = np.sort(softmax, axis=1)[:, ::-1][:, :KEPT]
    np.testing.assert_allclose(
        np.sort(kept, axis=1)[:, ::-1][:, :KEPT], largest, atol=0.51 / LEVELS
    )
    np.testing.assert_array_less(np.abs(kept - softmax)[kept > 0], 0.51 / LEVELS)
