# SPDX-License-Identifier: MIT
"""Files of poses."""

import numpy as np
import pytest
from scans import refused
from street_poses import CAMERA, along

from salsanext_cli.core.errors import FormatError
from salsanext_cli.io.poses import encode_poses, pose_readings, read_fused_poses

STEMS = ("000000", "000001", "000002")


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
