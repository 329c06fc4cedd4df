# SPDX-License-Identifier: MIT
"""Poses of the scans of a drive."""

from salsanext_cli.core.records import Double, Float

Points = Double | Float  # (N, 3), metres
Poses = Double
"""(N, 4, 4), or (4, 4) for one scan: from the frame of the scan to that of the drive, metres."""
POSES = "poses.txt"
CALIBRATION = "calib.txt"


def rotation(x: float, y: float, z: float, w: float) -> list[list[float]]:
    """Return the matrix (3, 3) of a quaternion of length 1."""
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
