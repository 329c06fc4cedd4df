# SPDX-License-Identifier: MIT
"""Drives of scans in the frame of a map."""

from dataclasses import replace

import numpy as np
from map_drives import WAY, drive
from scans import SMALL

from salsanext_cli.runs.drives.poses_of_sequence import points_of_drive, registered_drive
from salsanext_cli.runs.results.recorded_origins import recorded_origins
from salsanext_cli.runs.scans.scan_search import find_scans


def test_the_poses_of_a_registered_drive_are_the_positions_of_its_sensor(map_drive):
    files = find_scans(map_drive / "velodyne")
    sensor = replace(SMALL, registered=True)
    origin_of = recorded_origins(map_drive, sensor)
    poses = registered_drive(files, sensor, origin_of).poses
    assert np.abs(poses[:, :3, 3] - WAY).max() < 0.6
    assert (poses[:, :3, :3] == np.eye(3)).all()
    for file, scan, pose in zip(files, drive(), poses, strict=True):
        points = points_of_drive(file, sensor, origin_of)
        assert np.abs(points + pose[:3, 3] - scan.points).max() < 1e-4
        assert np.array_equal(points_of_drive(file, SMALL, origin_of), scan.points)
