# SPDX-License-Identifier: MIT
"""Whether poses fit their scans."""

import numpy as np
import pytest
from scans import make_scan, refused
from street_poses import CAMERA, along, street

from salsanext_cli.core.errors import FormatError
from salsanext_cli.core.fusion.pose_checks import (
    best_reading,
    fitting_parts,
    overlap,
    require_fitting,
    upright_points,
)


def moved(poses, start, by):
    """Return poses that are elsewhere from a number on."""
    return np.concatenate([poses[:start], by @ poses[start:]])


def shift(x, y):
    pose = np.eye(4)
    pose[:2, 3] = x, y
    return pose


WAY = along(*range(0, 24, 2))
SEEN = street(WAY)
TURNED = np.diag([-1.0, -1, 1, 1])


def test_overlap_is_the_share_of_points_in_voxels_of_the_other():
    first, second = upright_points(SEEN(0)), upright_points(SEEN(1))
    step = np.linalg.inv(WAY[0]) @ WAY[1]
    near = second[np.hypot(second[:, 0], second[:, 1]) < 30][::2]
    size = [0.5, 0.5, 2.0]
    voxels = {tuple(voxel) for voxel in np.floor(first / size).astype(int)}
    placed = near @ step[:3, :3].T + step[:3, 3]
    found = [tuple(voxel) in voxels for voxel in np.floor(placed / size).astype(int)]
    assert overlap(second, first, step) == np.mean(found) > 0.9
    assert overlap(second[:0], first, step) == 0
    assert overlap(second, first, shift(500, 0)) == 0


def test_the_reading_with_the_best_fit_is_chosen():
    """The car gains speed, so that poses of the next scan are wrong ones."""
    faster = along(*(0.2 * n * n for n in range(12)))
    right, late = faster[:11], faster[1:]
    assert best_reading([late, right], street(right)) == 1
    assert best_reading([right, late], street(right)) == 0
    assert best_reading([late], street(right)) == 0
    assert best_reading([late[:1], right[:1]], street(right)) == 0
    assert best_reading([late, right], lambda number: street(right)(number)[:0]) == 0


def test_a_drive_is_cut_where_its_scans_do_not_meet():
    for poses, parts in (
        (WAY, [0] * 12),
        (moved(WAY, 6, shift(6, 0)), [0] * 6 + [1] * 6),
        (moved(WAY, 6, shift(0, 3)), [0] * 6 + [1] * 6),
        (moved(WAY, 6, shift(500, 0)), [0] * 6 + [1] * 6),
        (np.concatenate([WAY[:6], WAY[6:7] @ TURNED, WAY[7:]]), [0] * 6 + [1] + [0] * 5),
    ):
        assert fitting_parts(poses, SEEN)[0].tolist() == parts
        assert require_fitting("poses.txt", poses, SEEN).tolist() == parts


def test_scans_without_upright_points_go_on_with_the_part():
    def seen(number):
        return SEEN(number) if number != 5 else np.full((7, 3), np.nan)

    assert fitting_parts(WAY, seen)[0].tolist() == [0] * 12
    flat = fitting_parts(WAY, lambda number: SEEN(number) * [1, 1, 0])
    assert flat[0].tolist() == [0] * 12
    assert flat[1] == 0
    away = moved(WAY, 6, shift(500, 0))
    assert fitting_parts(away, lambda number: SEEN(number)[:9])[0].tolist() == [0] * 6 + [1] * 6


def test_poses_must_align_the_scans_and_of_a_slow_drive_over_some_metres():
    frozen = WAY.copy()
    frozen[6:] = WAY[6]
    inverse, backwards = np.linalg.inv(WAY), along(*range(0, -84, -7))
    for wrong in (inverse, backwards, frozen, CAMERA @ WAY @ np.linalg.inv(CAMERA)):
        with pytest.raises(FormatError):
            require_fitting("poses.txt", wrong, SEEN)
    slow = along(*np.arange(0, 12, 0.4))
    seen = street(slow)
    assert require_fitting("poses.txt", slow, seen).tolist() == [0] * 30
    for wrong in (np.tile(np.eye(4), (30, 1, 1)), CAMERA @ slow @ np.linalg.inv(CAMERA)):
        refused(FormatError, "poses.txt", require_fitting, "poses.txt", wrong, seen)


@pytest.mark.parametrize(("factor", "unit"), [(100, "centimetres"), (1000, "millimetres")])
def test_poses_in_other_units_are_refused(factor, unit):
    with pytest.raises(FormatError) as caught:
        require_fitting("poses.txt", WAY * [1, 1, 1, factor], SEEN)
    assert caught.value.problem == f"positions in {unit}"


def test_laps_and_halts_are_one_part_and_scans_may_stand_apart_or_still():
    still = np.tile(np.eye(4), (3, 1, 1))
    assert require_fitting("p", still, lambda number: make_scan().points).tolist() == [0, 0, 0]
    apart = along(0, 200, 400)
    parts = require_fitting("p", apart, lambda number: make_scan(seed=number).points)
    assert parts.tolist() == [0, 1, 2]
    assert require_fitting("p", along(0), SEEN).tolist() == [0]
    halt = along(*[0.0] * 40, 2, 4, 6)
    assert not fitting_parts(halt, street(halt))[0].any()
    there = np.array(range(0, 24, 3))
    laps = along(*there, *there[::-1], *there)
    laps[:, :3, :3] = np.eye(3)
    assert not fitting_parts(laps, street(laps))[0].any()
