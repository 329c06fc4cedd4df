# SPDX-License-Identifier: MIT
"""Poses of a drive from its scans alone: registration to a map of the last scans (small_gicp)."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from salsanext_cli.core.fusion.drive import Drive
from salsanext_cli.core.fusion.pose_checks import (
    MARGIN,
    MIN_OVERLAP,
    MIN_UPRIGHT,
    SURE_OVERLAP,
    overlap,
    upright_points,
)
from salsanext_cli.core.fusion.poses import Points, Poses
from salsanext_cli.core.optional_packages import import_extra
from salsanext_cli.core.records import Float

MIN_RANGE_M = 2.0  # Nearer points lie on the vehicle.
DOWNSAMPLED_M, MAP_VOXEL_M, MAX_CORRESPONDENCE_M = 0.3, 1.0, 2.0
MAP_SCANS = 100  # Scans after which a location that was not seen again leaves the map
OTHER_STEPS = tuple(
    np.block([[np.eye(3), np.array(place)[:, None]], [0, 0, 0, 1]])
    for size in (2.0, -2.0, 4.0, 6.0, 8.0, 11.0, 14.0)
    for place in ((size, 0, 0), (0, size, 0))
)
"""Steps that are compared if the step before fits less well than then, as at the start."""
MAX_DROP = 0.2  # Largest loss of overlap from scan to scan; wrong poses along houses overlap, too
PART_M = 1000.0  # Distance to the origin of the next part of a drive


@dataclass(slots=True)
class RegisteredPart:
    """Part of a drive: a map of its last scans, and the last of them."""

    number: int
    map: Any
    index: int  # Number of the last scan
    pose: Poses
    step: Poses  # From the scan before to the last
    upright: Points
    share: float = 1.0  # Overlap of the last scan with the one before


def register(scans: Iterable[Float]) -> Drive:
    """Return the drive of scans, points (M, 3) in metres in the frame of each scan.

    A scan that fits neither of the two last parts begins another, `PART_M` farther along x.
    """
    small_gicp = import_extra("small_gicp", "fuse")
    poses: list[Poses] = []
    numbers: list[int] = []
    parts: list[RegisteredPart] = []
    for index, points in enumerate(scans):
        far = points[np.linalg.norm(points, axis=1) > MIN_RANGE_M].astype(np.float64)
        upright = upright_points(far)
        start = np.eye(4)
        start[0, 3] = PART_M + max(pose[0, 3] for pose in poses) if poses else 0
        part = RegisteredPart(max(numbers, default=-1) + 1, None, index, start, np.eye(4), upright)
        if len(upright) >= MIN_UPRIGHT:
            cloud, _ = small_gicp.preprocess_points(
                far, downsampling_resolution=DOWNSAMPLED_M, num_threads=1
            )
            for last in parts:
                share, pose = _aligned(small_gicp, last, cloud, index, upright)
                if share >= max(MIN_OVERLAP, min(last.share, SURE_OVERLAP) - MAX_DROP):
                    step = np.linalg.inv(last.pose) @ pose
                    step = step if index == last.index + 1 else last.step
                    part = RegisteredPart(last.number, last.map, index, pose, step, upright, share)
                    break
            if part.map is None:
                part.map = small_gicp.GaussianVoxelMap(MAP_VOXEL_M)
                part.map.set_lru(horizon=MAP_SCANS)
            part.map.insert(cloud, part.pose)
            parts = [part, *(last for last in parts if last.number != part.number)][:2]
        poses.append(part.pose)
        numbers.append(part.number)
    return Drive(np.array(poses).reshape(-1, 4, 4), np.array(numbers, np.int64))


def _aligned(
    small_gicp: Any, part: RegisteredPart, cloud: Any, index: int, upright: Points
) -> tuple[float, Poses]:
    """Return the overlap of a scan with the last scan of a part, and its pose."""
    best = 0.0, part.pose
    going_on = np.linalg.matrix_power(part.step, index - part.index)
    for number, step in enumerate((going_on, *OTHER_STEPS)):
        result = small_gicp.align(
            part.map,
            cloud,
            init_T_target_source=part.pose @ step,
            max_correspondence_distance=MAX_CORRESPONDENCE_M,
            num_threads=1,
        )
        pose: Poses = result.T_target_source
        if np.isfinite(pose).all():
            share = overlap(upright, part.upright, np.linalg.inv(part.pose) @ pose)
            best = max(best, (share, pose), key=lambda result: result[0])
        if number == 0 and best[0] >= max(MIN_OVERLAP, part.share - MARGIN):
            break
    return best
