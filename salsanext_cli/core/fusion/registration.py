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
from salsanext_cli.core.optional_packages import import_extra
from salsanext_cli.core.poses import Points, Poses
from salsanext_cli.core.records import Float

MIN_RANGE_M = 2.0  # Nearer points lie on the vehicle.
DOWNSAMPLED_M = 0.3  # Edge of the voxels with one point of a scan
MAP_VOXEL_M = 1.0  # Edge of the voxels of the map
MAX_CORRESPONDENCE_M = 2.0  # Largest distance of a point from its counterpart
MAP_SCANS = 100  # Scans after which a location that was not seen again leaves the map
OTHER_STEPS = tuple(
    np.block([[np.eye(3), np.array(place)[:, None]], [0, 0, 0, 1]])
    for size in (2.0, -2.0, 4.0, 6.0, 8.0, 11.0, 14.0)
    for place in ((size, 0, 0), (0, size, 0))
)
"""Steps that are compared if the step before fits less well than then, as at the start."""
MAX_DROP = 0.2  # Largest loss of overlap from scan to scan; wrong poses along houses overlap, too
PART_M = 1000.0  # Distance to the origin of the next part of a drive


@dataclass(slots=True, kw_only=True)
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
    """Return the drive of scans.

    A scan that fits neither of the two last parts begins another, `PART_M` farther along x.

    Parameters
    ----------
    scans : iterable of (M, 3) float32
        Measured points of each scan in its own frame, in metres.

    Returns
    -------
    Drive
        Poses of N scans and their parts.
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
        current = RegisteredPart(
            number=max(numbers, default=-1) + 1,
            map=None,
            index=index,
            pose=start,
            step=np.eye(4),
            upright=upright,
        )
        if len(upright) >= MIN_UPRIGHT:
            cloud, _ = small_gicp.preprocess_points(
                far, downsampling_resolution=DOWNSAMPLED_M, num_threads=1
            )
            for last in parts:
                share, pose = _aligned(small_gicp, last, cloud, index, upright)
                if share >= max(MIN_OVERLAP, min(last.share, SURE_OVERLAP) - MAX_DROP):
                    step = np.linalg.inv(last.pose) @ pose
                    current = RegisteredPart(
                        number=last.number,
                        map=last.map,
                        index=index,
                        pose=pose,
                        step=step if index == last.index + 1 else last.step,
                        upright=upright,
                        share=share,
                    )
                    break
            if current.map is None:
                current.map = small_gicp.GaussianVoxelMap(MAP_VOXEL_M)
                current.map.set_lru(horizon=MAP_SCANS)
            current.map.insert(cloud, current.pose)
            others = [last for last in parts if last.number != current.number]
            parts = [current, *others][:2]
        poses.append(current.pose)
        numbers.append(current.number)
    return Drive(np.array(poses).reshape(-1, 4, 4), np.array(numbers, np.int64))


def _aligned(
    small_gicp: Any, last: RegisteredPart, cloud: Any, index: int, upright: Points
) -> tuple[float, Poses]:
    """Return the overlap of a scan with the last scan of a part, and its pose."""
    best_share = 0.0
    best_pose = last.pose
    going_on = np.linalg.matrix_power(last.step, index - last.index)
    for number, step in enumerate((going_on, *OTHER_STEPS)):
        result = small_gicp.align(
            last.map,
            cloud,
            init_T_target_source=last.pose @ step,
            max_correspondence_distance=MAX_CORRESPONDENCE_M,
            num_threads=1,
        )
        pose: Poses = result.T_target_source
        if np.isfinite(pose).all():
            share = overlap(upright, last.upright, np.linalg.inv(last.pose) @ pose)
            if share > best_share:
                best_share = share
                best_pose = pose
        if number == 0 and best_share >= max(MIN_OVERLAP, last.share - MARGIN):
            break
    return best_share, best_pose
