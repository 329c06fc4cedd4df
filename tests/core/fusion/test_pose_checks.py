# SPDX-License-Identifier: MIT
"""Files of poses, and whether poses fit their scans."""

import numpy as np
import pytest
from scans import make_scan, refused

from salsanext_cli.core.errors import FormatError
from salsanext_cli.core.fusion.pose_checks import (
    best_reading,
    fitting_parts,
    overlap,
    require_fitting,
    upright_points,
)
from salsanext_cli.io.poses import encode_poses, pose_readings, read_fused_poses

CAMERA = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
"""From x forward, y left, z up to the camera's x right, y down, z forward."""
STEMS = ("000000", "000001", "000002")


def along(*places):
    """Return poses of scans at places along x, turning a little."""
    poses = np.tile(np.eye(4), (len(places), 1, 1))
    for number, place in enumerate(places):
        turn = 0.05 * number
        poses[number, :2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
        poses[number, 0, 3] = place
    return poses


def read_poses(path, scans, wanted):
    (poses,) = pose_readings(path, scans, wanted)
    return poses


def written(folder, content):
    path = folder / "poses.txt"
    path.write_bytes(content)
    return path


def test_names_may_be_line_numbers_from_0_or_from_1(tmp_path):
    path = written(tmp_path, encode_poses(along(*range(10))))
    for scans, wanted, readings in (
        ("2 7", "2 7", [[2, 7], [1, 6]]),
        ("2 7", "7", [[7], [6]]),
        ("0 2 7", "2 7", [[2, 7]]),
        ("2 7 a", "2 7", [[2, 7]]),
    ):
        found = pose_readings(path, scans.split(), wanted.split())
        assert [poses[:, 0, 3].tolist() for poses in found] == readings
    for scans, wanted in (("0 10", "10"), ("2 10", "2 10"), ("2 a", "a")):
        with pytest.raises(FormatError, match="10 lines"):
            pose_readings(path, scans.split(), wanted.split())
    with pytest.raises(FormatError, match="10 lines"):
        read_fused_poses(path, ["2", "7"])


def test_tum_is_read_as_kitti(tmp_path):
    poses = along(3, 4, 5)
    half = [0.05 * number / 2 for number in range(3)]
    lines = ["# time x y z qx qy qz qw"]
    lines += [f"{n} {n + 3} 0 0 0 0 {np.sin(h)} {np.cos(h)}" for n, h in enumerate(half)]
    path = written(tmp_path, "\n".join(lines).encode())
    np.testing.assert_allclose(read_poses(path, STEMS, STEMS), poses, atol=1e-12)


def test_poses_of_the_camera_become_poses_of_the_scans(tmp_path):
    poses = along(0, 1, 2)
    of_camera = CAMERA @ poses @ np.linalg.inv(CAMERA)
    path = written(tmp_path, encode_poses(of_camera))
    row = " ".join(map(str, CAMERA[:3].ravel()))
    (tmp_path / "calib.txt").write_text(f"P0: 1 0 0 0 0 1 0 0 0 0 1 0\nTr: {row}\n")
    np.testing.assert_allclose(read_poses(path, STEMS, STEMS), poses, atol=1e-8)
    for line in ("P0", "Tr"):
        (tmp_path / "calib.txt").write_text(f"{line}: 1 0 0 0 0 1 0 0 0 0 0 0\n")
        refused(FormatError, tmp_path / "calib.txt", read_poses, path, STEMS, STEMS)


def test_the_hint_of_a_calibration_without_tr_works(tmp_path):
    """KITTI's archives of images have a calibration without the position of the scanner."""
    poses = along(0, 1, 2)
    path = written(tmp_path, encode_poses(poses))
    (tmp_path / "calib.txt").write_text("P0: 1 0 0 0 0 1 0 0 0 0 1 0\n")
    caught = refused(FormatError, tmp_path / "calib.txt", read_poses, path, STEMS, STEMS)
    for remedy in ("calib.txt that has Tr", 'poses="FILE"', "rename poses.txt"):
        assert remedy in caught.value.hint
    elsewhere = tmp_path / "poses"
    elsewhere.mkdir()
    path = written(elsewhere, encode_poses(poses))
    np.testing.assert_allclose(read_poses(path, STEMS, STEMS), poses, atol=1e-12)


def test_rounded_rotations_become_rigid(tmp_path):
    poses = along(0, 1, 2)
    path = written(tmp_path, encode_poses(poses * [[1.004], [1.004], [1.004], [1]]))
    turns = read_poses(path, STEMS, STEMS)[:, :3, :3]
    np.testing.assert_allclose(turns, poses[:, :3, :3], atol=1e-8)
    exact = read_poses(written(tmp_path, encode_poses(poses)), STEMS, STEMS)
    np.testing.assert_array_equal(exact, poses)
    np.testing.assert_array_equal(read_poses(path, STEMS, STEMS[1:]), poses[1:])


def test_damaged_lines_are_refused_by_their_number(tmp_path):
    for content, number in (
        (encode_poses(along(0, 1)), "2 lines"),
        (b"1 2 3\n" * 3, "line 1"),
        (b"a b\n" * 3, "line 1"),
        (b"", "0 lines"),
        ((b"nan " * 12 + b"\n") * 3, "line 1"),
        (encode_poses(along(0, 1, 2) * 1.1), "line 1"),
        (encode_poses(along(0, 1, 2) @ np.diag([1, 1, -1, 1.0])), "line 1"),
        (b"0 1 2 3 0 0 0.5 0.5\n" * 3, "line 1 .* 0.707"),
        (encode_poses(along(0, 1e308, 2)), r"line 2 .* 1e\+308 m"),
        (b"0 1 -1e12 3 0 0 0 1\n" * 3, r"line 1 .* 1e\+12 m"),
    ):
        with pytest.raises(FormatError, match=number):
            read_poses(written(tmp_path, content), ("a", "b", "c"), ("a", "b", "c"))


def street(poses):
    """Return a function from a scan's number to what is seen of a street's posts and kerbs."""
    random = np.random.default_rng(0)
    posts = random.uniform([-40, -15, 0], [80, 15, 0], (90, 3))
    points = np.repeat(posts, 120, axis=0) + random.uniform(-0.4, 0.4, (10800, 3)) * [1, 1, 0]
    points[:, 2] = random.uniform(-1.5, 2, 10800)
    ground = random.uniform([-40, -15, -1.75], [80, 15, -1.7], (9000, 3))
    world = np.concatenate([points, ground])
    return lambda number: (world - poses[number, :3, 3]) @ poses[number, :3, :3]


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
