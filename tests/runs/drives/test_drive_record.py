# SPDX-License-Identifier: MIT
"""The record of the drive by which a sequence was fused."""

import json

import numpy as np
import pytest
from scans import refused
from street_poses import along

from salsanext_cli.core.errors import OutputError, SalsanextError
from salsanext_cli.core.fusion.drive import Drive
from salsanext_cli.io.poses import encode_poses
from salsanext_cli.runs.drives.drive_record import drive_record, recorded_drive

STEMS = ["000000", "000001", "000002"]
DRIVE = Drive(along(3, 4, 50), np.array([0, 0, 1]))


@pytest.fixture
def folder(tmp_path):
    """Return the folder of a sequence with poses and their record."""
    (tmp_path / "poses.txt").write_bytes(encode_poses(DRIVE.poses))
    (tmp_path / "drive.json").write_text(json.dumps(drive_record(DRIVE, STEMS)))
    return tmp_path


def test_a_recorded_drive_is_read_back(folder):
    drive = recorded_drive(folder)
    np.testing.assert_allclose(drive.poses, DRIVE.poses, atol=1e-8)
    assert drive.parts.tolist() == [0, 0, 1]


@pytest.mark.parametrize("name", ["poses.txt", "drive.json"])
def test_a_folder_without_poses_or_record_has_no_drive(folder, name):
    (folder / name).unlink()
    assert recorded_drive(folder) is None


def test_edited_poses_are_refused(folder):
    edited = DRIVE.poses.copy()
    edited[1, 0, 3] += 0.01
    (folder / "poses.txt").write_bytes(encode_poses(edited))
    refused(OutputError, folder / "poses.txt", recorded_drive, folder)


@pytest.mark.parametrize("content", [{}, {"scans": 3}, {"scans": STEMS, "parts": ["x"]}])
def test_a_damaged_record_is_refused(folder, content):
    (folder / "drive.json").write_text(json.dumps(content))
    refused(SalsanextError, folder / "drive.json", recorded_drive, folder)
