# SPDX-License-Identifier: MIT
import numpy as np
import pytest
from scans import make_scan

from salsanext_cli.errors import FormatError
from salsanext_cli.fusion.poses import (
    CAMERA,
    encode_poses,
    overlap,
    read_fused_poses,
    read_poses,
    require_fitting,
    segments,
)

STEMS = ("000000", "000001", "000002")


def along(*places):
    """Return poses of scans at places along x, turning a little."""
    poses = np.tile(np.eye(4), (len(places), 1, 1))
    for number, place in enumerate(places):
        turn = 0.05 * number
        poses[number, :2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
        poses[number, 0, 3] = place
    return poses


def written(folder, content):
    path = folder / "poses.txt"
    path.write_bytes(content)
    return path


def test_kitti_is_read_as_written(tmp_path):
    poses = along(0, 1, 2.5)
    path = written(tmp_path, encode_poses(poses))
    np.testing.assert_allclose(read_poses(path, STEMS, STEMS), poses, atol=1e-8)
    np.testing.assert_allclose(read_poses(path, STEMS, STEMS[1:])[1][0, 3], 2.5)


def test_a_file_of_a_whole_drive_has_a_line_per_number(tmp_path):
    path = written(tmp_path, encode_poses(along(*range(10))))
    poses = read_poses(path, ["000002", "000007"], ["000002", "000007"])
    np.testing.assert_allclose(poses[:, 0, 3], [2, 7])
    with pytest.raises(FormatError, match="10 lines"):
        read_fused_poses(path, ["000002", "000007"], ["000002", "000007"])


def test_tum_is_read_as_kitti(tmp_path):
    poses = along(3, 4, 5)
    half = [0.05 * number / 2 for number in range(3)]
    lines = ["# time x y z qx qy qz qw"]
    lines += [f"{n} {n + 3} 0 0 0 0 {np.sin(h)} {np.cos(h)}" for n, h in enumerate(half)]
    path = written(tmp_path, "\n".join(lines).encode())
    np.testing.assert_allclose(read_poses(path, STEMS, STEMS), poses, atol=1e-12)


def test_poses_of_the_camera_become_those_of_the_scans(tmp_path):
    poses = along(0, 1, 2)
    of_camera = CAMERA @ poses @ np.linalg.inv(CAMERA)
    path = written(tmp_path, encode_poses(of_camera))
    row = " ".join(map(str, CAMERA[:3].ravel()))
    (tmp_path / "calib.txt").write_text(f"P0: 1 0 0 0 0 1 0 0 0 0 1 0\nTr: {row}\n")
    np.testing.assert_allclose(read_poses(path, STEMS, STEMS), poses, atol=1e-8)
    (tmp_path / "calib.txt").write_text("P0: 1 0 0 0 0 1 0 0 0 0 1 0\n")
    with pytest.raises(FormatError, match="no line Tr"):
        read_poses(path, STEMS, STEMS)


@pytest.mark.parametrize(
    ("content", "found"),
    [
        (encode_poses(along(0, 1)), "2 lines"),
        (b"1 2 3\n" * 3, "line 1: '1 2 3'"),
        (b"a b\n" * 3, "line 1: 'a b'"),
        (b"nan " * 12 + b"\n" + b"1 " * 12, "2 lines"),
        ((b"nan " * 12 + b"\n") * 3, "line 1"),
        (encode_poses(along(0, 1, 2) * 1.1), "line 1 is no rotation"),
        (encode_poses(along(0, 1, 2) @ np.diag([1, 1, -1, 1.0])), "line 1 mirrors the scan"),
        (b"0 1 2 3 0 0 0.5 0.5\n" * 3, "line 1 is no rotation"),
        (b"", "0 lines"),
    ],
)
def test_what_is_no_pose_is_refused(tmp_path, content, found):
    with pytest.raises(FormatError, match=found):
        read_poses(written(tmp_path, content), ("a", "b", "c"), ("a", "b", "c"))


def test_a_drive_is_cut_where_a_step_is_out_of_sight():
    assert segments(along(0, 1, 2, 60, 61)).tolist() == [0, 0, 0, 1, 1]
    assert segments(along(*range(20), 40, 41)).tolist() == [0] * 20 + [1, 1]
    assert segments(along(0, 0, 0, 0, 12, 24, 36)).tolist() == [0] * 7
    assert segments(along(0, 13, 26, 39)).tolist() == [0, 0, 0, 0]
    assert segments(along(0, 0, 0)).tolist() == [0, 0, 0]
    assert segments(along(0)).tolist() == [0]
    assert segments(along(0, 100, 200)).tolist() == [0, 1, 2]


def street():
    """Return the points of a street's posts and kerbs seen from places along it, by number."""
    random = np.random.default_rng(0)
    posts = random.uniform([-30, -15, 0], [60, 15, 0], (60, 3))
    points = np.repeat(posts, 200, axis=0) + random.uniform(-0.4, 0.4, (12000, 3)) * [1, 1, 0]
    points[:, 2] = random.uniform(-1.5, 2, 12000)
    ground = random.uniform([-30, -15, -1.75], [60, 15, -1.7], (6000, 3))
    world = np.concatenate([points, ground])
    poses = along(0, 2, 4, 6)

    def seen(number):
        return (world - poses[number, :3, 3]) @ poses[number, :3, :3]

    return poses, seen


def test_poses_must_lay_the_scans_on_each_other(tmp_path):
    poses, seen = street()
    parts = segments(poses)
    require_fitting(tmp_path, poses, parts, seen)
    assert overlap(seen(0), seen(1), np.linalg.inv(poses[1]) @ poses[0]) > 0.9
    in_centimetres = poses.copy()
    in_centimetres[:, :3, 3] *= 100
    wrong = {
        "world to the scans": np.linalg.inv(poses),
        "poses that are of the camera": CAMERA @ poses @ np.linalg.inv(CAMERA),
        "in centimetres": in_centimetres,
        "do not fit|fit worse": along(0, -7, -14, -21),
        "do not fit": along(0, 0, 0, 0),
    }
    for found, each in wrong.items():
        with pytest.raises(FormatError, match=found):
            require_fitting(tmp_path, each, segments(each), seen)


def test_scans_that_stand_apart_or_still_may_have_such_poses(tmp_path):
    still = np.tile(np.eye(4), (3, 1, 1))
    require_fitting(tmp_path, still, segments(still), lambda number: make_scan().points)
    apart = along(0, 200, 400)
    require_fitting(tmp_path, apart, segments(apart), lambda number: make_scan(seed=number).points)
