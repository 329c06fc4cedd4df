# SPDX-License-Identifier: MIT
import numpy as np
import pytest

from salsanext_cli.errors import FormatError
from salsanext_cli.fusion.pose_checks import CAMERA
from salsanext_cli.fusion.poses import (
    encode_poses,
    read_fused_poses,
    read_poses,
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
    for line, found in (("P0", "no line Tr"), ("Tr", "Tr scales, shears or mirrors")):
        (tmp_path / "calib.txt").write_text(f"{line}: 1 0 0 0 0 1 0 0 0 0 0 0\n")
        with pytest.raises(FormatError, match=found):
            read_poses(path, STEMS, STEMS)


def test_rounded_rotations_become_rigid(tmp_path):
    poses = along(0, 1, 2)
    path = written(tmp_path, encode_poses(poses * [[1.004], [1.004], [1.004], [1]]))
    np.testing.assert_allclose(
        read_poses(path, STEMS, STEMS)[:, :3, :3], poses[:, :3, :3], atol=1e-8
    )
    exact = read_poses(written(tmp_path, encode_poses(poses)), STEMS, STEMS)
    np.testing.assert_array_equal(exact, poses)
    np.testing.assert_array_equal(read_poses(path, STEMS, STEMS[1:]), poses[1:])


def test_what_is_no_pose_is_refused(tmp_path):
    for content, found in (
        (encode_poses(along(0, 1)), "2 lines"),
        (b"1 2 3\n" * 3, "line 1: '1 2 3'"),
        (b"a b\n" * 3, "line 1: 'a b'"),
        (b"nan " * 12 + b"\n" + b"1 " * 12, "2 lines"),
        ((b"nan " * 12 + b"\n") * 3, "line 1"),
        (encode_poses(along(0, 1, 2) * 1.1), "line 1 scales"),
        (
            encode_poses(along(0, 1, 2) @ np.diag([1, 1, -1, 1.0])),
            "line 1 scales",
        ),
        (b"0 1 2 3 0 0 0.5 0.5\n" * 3, "line 1 has a quaternion of length 0.707"),
        (b"", "0 lines"),
    ):
        with pytest.raises(FormatError, match=found):
            read_poses(written(tmp_path, content), ("a", "b", "c"), ("a", "b", "c"))
