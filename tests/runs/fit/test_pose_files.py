# SPDX-License-Identifier: MIT
"""Where the poses of a sequence are, and which of them are those of some of its scans."""

from dataclasses import replace

import numpy as np
import pytest
from scans import write_bin
from street_poses import along

from salsanext_cli import Scan
from salsanext_cli.core.errors import FormatError
from salsanext_cli.io.poses import encode_poses
from salsanext_cli.runs.fit.pose_files import poses_beside, position_in_file, readings_of
from salsanext_cli.runs.scans.scan_search import find_scans

SCAN = Scan(np.ones((3, 3), np.float32), np.zeros(3, np.float32))


@pytest.mark.parametrize("folder", ["velodyne", "drive"])
def test_poses_are_in_the_folder_of_the_sequence(tmp_path, folder):
    for stem in ("000000", "000001", "000002"):
        write_bin(tmp_path / folder / f"{stem}.bin", SCAN)
    files = find_scans(tmp_path / folder)
    assert poses_beside(files) is None
    path = (tmp_path if folder == "velodyne" else tmp_path / folder) / "poses.txt"
    path.write_bytes(encode_poses(along(3, 4, 5)))
    assert poses_beside(files) == path
    (poses,) = readings_of(path, [files[2], files[0]])
    np.testing.assert_allclose(poses, along(3, 4, 5)[[2, 0]], atol=1e-8)
    path.write_bytes(encode_poses(along(3, 4)))
    with pytest.raises(FormatError) as caught:
        readings_of(path, files)
    assert caught.value.subject == str(path)


def test_a_position_in_a_file_is_shifted_by_the_frame_of_its_scan():
    notes = replace(SCAN.notes, frame=(500_000.0, 5_400_000.0, 0.0))
    scan = replace(SCAN, notes=notes)
    assert position_in_file((1.0, 2.0, 3.0), scan).tolist() == [500_001, 5_400_002, 3]
