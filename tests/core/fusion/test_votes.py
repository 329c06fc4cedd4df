# SPDX-License-Identifier: MIT
"""Votes of scans of a drive."""

import math
from collections import defaultdict

import numpy as np
import pytest
from fused_arrays import fuse
from hypothesis import given, settings
from hypothesis import strategies as st

from salsanext_cli import LabelSpace, Scan, label_space
from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.fusion.drive import Drive
from salsanext_cli.core.fusion.reach import FusionReach
from salsanext_cli.core.fusion.top_classes import LEVELS, STORED, softmax_of, top_classes
from salsanext_cli.core.fusion.votes import MAX_CELLS, SCALE, VOXEL_SIZES_M, keys_of
from salsanext_cli.core.fusion.window import FusionWindow, warn_without_movable_classes
from salsanext_cli.core.notices import warn_once

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


def slow_direction(point):
    x, y, z = map(float, point)
    column = math.floor((math.atan2(y, x) / math.pi + 1) / 2 * 1024)
    return column, math.floor(math.degrees(math.atan2(z, math.hypot(x, y))) / 90 * 256)


def slowly_nearest(scan):
    """Return the distance of the nearest point of a scan in each direction."""
    nearest = {}
    for point in scan.points.astype(float):
        direction = slow_direction(point)
        nearest[direction] = min(nearest.get(direction, np.inf), np.linalg.norm(point))
    return nearest


def slowly_standing(places, number, nearest, poses, reach):
    """Return of each place whether more of the other scans see something there than through."""
    standing = {}
    for voxel, place in places.items():
        there = through = 0
        for other in range(max(0, number - reach), min(len(nearest), number + reach + 1)):
            point = (place - poses[other][:3, 3]) @ poses[other][:3, :3]
            distance = np.linalg.norm(point)
            behind = nearest[other].get(slow_direction(point), np.nan) - distance
            inclination = math.degrees(math.atan2(point[2], math.hypot(*point[:2])))
            is_seen = other != number and abs(inclination) < 45
            there += is_seen and abs(behind) <= 0.3
            through += is_seen and behind > 0.3 + 0.1 * distance
        standing[voxel] = through < there
    return standing


def slow_view(world, softmax, size):
    """Return the mean softmax of the labelled points in each voxel."""
    voxels = defaultdict(list)
    for place, probabilities in zip(world, softmax, strict=True):
        if probabilities[0] < 1:
            voxels[tuple(np.floor(place / size))].append(probabilities)
    return {voxel: np.mean(all_, axis=0) for voxel, all_ in voxels.items()}


def slowly(scans, softmax, poses, reach, movable):
    """Add up votes in dictionaries."""
    results = []
    nearest = [slowly_nearest(scan) for scan in scans]
    worlds = [
        scan.points.astype(float) @ pose[:3, :3].T + pose[:3, 3]
        for scan, pose in zip(scans, poses, strict=True)
    ]
    views_by_size = [
        [
            slow_view(world, of_points, size)
            for world, of_points in zip(worlds, softmax, strict=True)
        ]
        for size in VOXEL_SIZES_M
    ]
    for index, world in enumerate(worlds):
        shares = np.zeros((len(VOXEL_SIZES_M), len(world), CLASSES))
        for which, size in enumerate(VOXEL_SIZES_M):
            views = views_by_size[which]
            firsts = {}
            for place, probabilities in zip(world, softmax[index], strict=True):
                if probabilities[0] < 1:
                    firsts.setdefault(tuple(np.floor(place / size)), place)
            asked = {k: v for k, v in firsts.items() if views[index][k][movable].sum() > 0.2}
            standing = slowly_standing(asked, index, nearest, poses, reach.reach)
            seen = np.zeros(len(world), int)
            for number, place in enumerate(world):
                voxel = tuple(np.floor(place / size))
                if softmax[index][number, 0] == 1:
                    continue
                total, counts = np.zeros(CLASSES), np.zeros(CLASSES)
                for other, view in enumerate(views):
                    away = abs(other - index)
                    if away <= reach.reach and voxel in view:
                        is_near = away <= reach.movable_reach
                        counted = is_near | ~movable | standing.get(voxel, False)
                        total += view[voxel] * counted
                        counts += counted
                        seen[number] += 1
                shares[which, number] = total / counts
                shares[which, number] /= shares[which, number].sum()
        results.append((shares.mean(axis=0), seen))
    return results


@settings(max_examples=max(8, settings().max_examples // 3))
@given(st.integers(0, 10_000), st.integers(0, 4), st.integers(0, 4))
def test_votes_equal_a_slow_loop(seed, reach, movable_reach):
    scans, softmax, poses = drive(seed)
    reaches = FusionReach(reach, min(reach, movable_reach))
    movable = label_space().movable
    expected = slowly(scans, softmax, poses, reaches, movable)
    for tally, (shares, views) in zip(fuse(scans, softmax, poses, reaches), expected, strict=True):
        np.testing.assert_array_equal(tally.scan_counts, views)
        # Each probability of a vote is rounded by half a step, and their sum by one per class.
        rounding = (1 + CLASSES) / 2 / SCALE
        np.testing.assert_allclose(tally.probabilities, shares, atol=rounding)


def test_a_label_changes_only_where_another_scan_sees_the_place_and_has_a_label():
    place = np.float32([[0.1, 0.1, 0.1], [5, 5, 5]])
    scans = [Scan(place[:count], np.zeros(count, np.float32)) for count in (2, 1, 1)]
    road, car = np.eye(CLASSES, dtype=np.float32)[[ROAD, CAR]]
    labels = np.uint8([CAR, CAR])
    tally = fuse(scans, [[car, road], [road], [road]], np.tile(np.eye(4), (3, 1, 1)))[0]
    assert tally.fused(labels).tolist() == [ROAD, CAR]
    np.testing.assert_allclose(tally.disagreement(labels), [2 / 3, 1], atol=1e-4)
    scan = Scan(np.zeros((2, 3), np.float32), np.zeros(2, np.float32))
    softmax = np.eye(CLASSES, dtype=np.float32)[[0, ROAD]]
    tally = fuse([scan], [softmax], np.eye(4)[None])[0]
    assert tally.scan_counts.tolist() == [0, 1]
    assert np.isnan(tally.disagreement(np.uint8([0, ROAD]))).tolist() == [True, False]
    assert tally.fused(np.uint8([0, ROAD])).tolist() == [0, ROAD]


def test_a_label_space_without_movable_classes_is_a_warning(caplog):
    labels = {0: "none", **{i: f"class {i}" for i in range(1, CLASSES)}}
    same = {i: i for i in labels}
    data = {"name": "silent", "labels": labels, "learning_map": same, "learning_map_inv": same}
    warn_once.cache_clear()
    for stated in ({"movable": []}, {"movable": [1]}, {}):
        assert not caplog.records
        warn_without_movable_classes(LabelSpace.from_dict(data | stated))
    assert [record.levelname for record in caplog.records] == ["WARNING"]
    assert "silent" in caplog.text


def test_voxels_have_different_keys_and_points_outside_have_none():
    random = np.random.default_rng(0)
    edge = MAX_CELLS * 0.3
    points = random.uniform(-1, 1, (500, 3)) * [[edge, 2, 2]]
    outside = [[edge + 1, 0, 0], [0, -1e6, 0], [0, 0, np.nan], [np.inf, 0, 0]]
    points[:6] = [*outside, [0] * 3, [0.1] * 3]
    keys = keys_of(points, 0.3)
    assert (keys[:4] == -1).all()
    assert (keys[4:] >= 0).all()
    cells = [tuple(np.floor(point / 0.3)) for point in points[4:]]
    assert len(set(keys[4:].tolist())) == len(set(cells)) < 496
    assert keys[4] == keys[5]


def test_a_stray_point_has_no_vote_and_does_no_harm():
    scans, softmax, poses = drive(0)
    expected = fuse(scans, softmax, poses)
    stray = np.float32([[1e6, 0, 0], [0, np.nan, 0], [0, 0, -np.inf], [3e38, 0, 0]])
    points = np.concatenate([scans[1].points, stray])
    scans[1] = Scan(points, np.zeros(len(points), np.float32))
    softmax[1] = np.concatenate([softmax[1], np.eye(CLASSES, dtype=np.float32)[[ROAD] * 4]])
    found = fuse(scans, softmax, poses)
    assert not found[1].scan_counts[-4:].any()
    for one, other in zip(found, expected, strict=True):
        count = len(other.scan_counts)
        np.testing.assert_array_equal(one.probabilities[:count], other.probabilities)
        np.testing.assert_array_equal(one.scan_counts[:count], other.scan_counts)


def test_parts_may_be_far_apart_but_not_the_scans_of_a_part():
    scans, softmax, poses = drive(0)
    alone = [*fuse(scans[:3], softmax[:3], poses[:3]), *fuse(scans[3:], softmax[3:], poses[3:])]
    poses[3:, 0, 3] += 1e8
    for one, other in zip(fuse(scans, softmax, poses), alone, strict=True):
        np.testing.assert_array_equal(one.probabilities, other.probabilities)
        np.testing.assert_array_equal(one.scan_counts, other.scan_counts)
    window = FusionWindow(
        Drive(poses, np.zeros(5, np.int64)),
        lambda index: (scans[index].points, softmax[index]),
        FusionReach(),
        np.zeros(CLASSES, bool),
    )
    assert window.tally(0).scan_counts.max() <= 3
    with pytest.raises(UsageError, match=r"scan 4.* 100000.0 km .* 314.1 km"):
        window.tally(4)


def test_a_window_that_jumps_frees_its_scans_before_it_reads_others():
    scans, softmax, poses = drive(0)
    held = []

    def read(index):
        held.append({*window.seen})
        return scans[index].points, softmax[index]

    parts, movable = np.zeros(5, np.int64), np.zeros(CLASSES, bool)
    window = FusionWindow(Drive(poses, parts), read, FusionReach(1, 1), movable)
    for index in (0, 1, 4):
        held.clear()
        window.tally(index)
        assert held
        assert set().union(*held) <= {index - 1, index, index + 1}


@given(st.integers(0, 10_000), st.integers(2, CLASSES))
def test_kept_classes_are_the_most_probable(seed, classes):
    softmax = np.random.default_rng(seed).dirichlet(np.full(classes, 0.4), 50).astype(np.float32)
    kept = softmax_of(top_classes(softmax), classes)
    assert ((kept > 0).sum(axis=1) <= STORED).all()
    largest = np.sort(softmax, axis=1)[:, ::-1][:, :STORED]
    of_kept = np.sort(kept, axis=1)[:, ::-1][:, :STORED]
    np.testing.assert_allclose(of_kept, largest, atol=0.51 / LEVELS)
    np.testing.assert_array_less(np.abs(kept - softmax)[kept > 0], 0.51 / LEVELS)
