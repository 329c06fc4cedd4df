# SPDX-License-Identifier: MIT
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from salsanext_cli import Scan
from salsanext_cli.fusion.drive_map import one_per_voxel
from salsanext_cli.fusion.window import fuse

ORIGIN = np.array([4e5, 5e6, 30.0])


def columns(seed, count, spread=2.0, part=0):
    random = np.random.default_rng(seed)
    places = ORIGIN + random.uniform(-spread, spread, (count, 3))
    found = dict(zip("xyz", places.T, strict=True))
    found["range"] = random.integers(1, 9, count).astype(np.float32)
    found |= {"scan": np.full(count, seed, np.int32), "part": np.full(count, part, np.int32)}
    return found | {"label": random.integers(0, 9, count)}


@given(st.lists(st.integers(1, 60), min_size=1, max_size=4))
def test_each_voxel_keeps_its_nearest_point(counts):
    parts = [columns(seed, count) for seed, count in enumerate(counts)]
    best = {}
    for part in parts:
        for i in range(len(part["x"])):
            place = np.array([part[axis][i] for axis in "xyz"]) - ORIGIN
            voxel = tuple(np.floor(place / 0.5).astype(int))
            point = (part["range"][i], part["scan"][i])
            best[voxel] = min(best.get(voxel, point), point)
    found = one_per_voxel(parts, 0.5, ORIGIN[None])
    assert len(found["x"]) == len(best)
    for i in range(len(found["x"])):
        place = np.array([found[axis][i] for axis in "xyz"]) - ORIGIN
        voxel = tuple(np.floor(place / 0.5).astype(int))
        assert best[voxel] == (found["range"][i], found["scan"][i])


def test_the_order_of_scans_and_merging_in_between_change_nothing():
    parts = [columns(seed, 500) for seed in range(4)]
    whole = one_per_voxel(parts, 0.5, ORIGIN[None])
    bit_by_bit = one_per_voxel(
        [parts[3], one_per_voxel(parts[:2], 0.5, ORIGIN[None]), parts[2]], 0.5, ORIGIN[None]
    )
    for name, values in whole.items():
        np.testing.assert_array_equal(values, bit_by_bit[name])


def test_parts_of_a_drive_keep_their_own_voxels():
    alone = [columns(0, 300), columns(1, 300, part=1)]
    origins = np.stack([ORIGIN, ORIGIN + [0.1, 0, 0]])
    found = one_per_voxel(alone, 0.5, origins)
    for part in (0, 1):
        own = one_per_voxel([alone[part]], 0.5, origins)
        for name, values in own.items():
            np.testing.assert_array_equal(found[name][found["part"] == part], values)


def test_points_without_a_voxel_and_what_not_every_scan_knows_are_left_out():
    points = columns(0, 5)
    points["x"][:2] = ORIGIN[0] + 1e12, np.nan
    found = one_per_voxel([points], 0.01, ORIGIN[None])
    assert sorted(found["label"]) == sorted(points["label"][2:])
    lacking = columns(1, 9)
    del lacking["label"]
    assert "label" not in one_per_voxel([columns(0, 9), lacking], 0.5, ORIGIN[None])


@pytest.mark.parametrize("far", [0.0, 6e6])
def test_votes_do_not_depend_on_the_place_of_the_world(far):
    random = np.random.default_rng(0)
    points = random.uniform(-5, 5, (200, 3)).astype(np.float32)
    scans = [Scan(points, np.zeros(200, np.float32))] * 2
    softmax = [random.dirichlet(np.ones(20), 200).astype(np.float32) for _ in scans]
    poses = np.tile(np.eye(4), (2, 1, 1))
    near = fuse(scans, softmax, poses)
    poses[:, :2, 3] += far
    for there, here in zip(fuse(scans, softmax, poses), near, strict=True):
        np.testing.assert_array_equal(there.probabilities, here.probabilities)
        np.testing.assert_array_equal(there.views, here.views)
