# SPDX-License-Identifier: MIT
"""Drives whose scans are in the frame of a map."""

from pathlib import Path

import numpy as np
from street_scans import moved, street

from salsanext_cli import Scan
from salsanext_cli.io.poses import encode_poses

WAY = [(0, 0, 0), (7, 0, 0), (14, 0, 0), (21, 0, 0)]


def drive() -> list[Scan]:
    """Return scans of a drive in the frame of the first one."""
    return [moved(street(32, seed=seed), place) for seed, place in enumerate(WAY)]


def write_poses(path: Path, positions: np.ndarray) -> None:
    """Write poses of a vehicle that turns by a degree from one to the next."""
    poses = np.tile(np.eye(4), (len(positions), 1, 1))
    for number, pose in enumerate(poses):
        cos, sin = np.cos(np.radians(number)), np.sin(np.radians(number))
        pose[:2, :2] = [[cos, -sin], [sin, cos]]
    poses[:, :3, 3] = positions
    path.write_bytes(encode_poses(poses))
