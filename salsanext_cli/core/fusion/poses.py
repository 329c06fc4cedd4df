# SPDX-License-Identifier: MIT
"""Poses of the scans of a drive."""

from salsanext_cli.core.records import Double, Float

Points = Double | Float  # (N, 3), metres
Poses = Double
"""(N, 4, 4), or (4, 4) for one scan: from the frame of the scan to that of the drive, metres."""
POSES = "poses.txt"
CALIBRATION = "calib.txt"
