# SPDX-License-Identifier: MIT
"""Poses of a drive from its scans alone: registration to a map of the last ones (small_gicp)."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from salsanext_cli.files.optional_packages import import_extra
from salsanext_cli.fusion.poses import MIN_OVERLAP, Poses, overlap
from salsanext_cli.records import Float

MIN_RANGE_M = 2.0
"""Nearer points are of the vehicle."""
DOWNSAMPLED_M, MAP_VOXEL_M, MAX_CORRESPONDENCE_M = 0.3, 1.0, 2.0
MAP_SCANS = 100
"""Scans after which a place that was not seen again leaves the map."""
MIN_POINTS = 200
"""Fewer points tell no motion."""
OTHER_STEPS = tuple(
    np.block([[np.eye(3), np.array(place)[:, None]], [0, 0, 0, 1]])
    for size in (2.0, -2.0, 5.0, 9.0, 14.0)
    for place in ((size, 0, 0), (0, size, 0))
)
"""Steps that are tried where going on as before leads nowhere, as at the start of a drive."""
PART_M = 1000.0
"""Distance to the origin of the next part of a drive."""


def register(scans: Iterable[Float]) -> Poses:
    """Return the poses of scans, each (M, 3) metres in its own frame.

    The first is the frame of the drive. Where a scan does not come to lie on the one before, a
    part of the drive begins whose place is not known: it starts `PART_M` farther along x.
    """
    small_gicp = import_extra("small_gicp", "fuse")
    poses: list[Poses] = []
    target: Any = None
    before, step = np.zeros((0, 3)), np.eye(4)
    for points in scans:
        far = points[np.linalg.norm(points, axis=1) > MIN_RANGE_M].astype(np.float64)
        cloud: Any = None
        pose: Poses | None = None
        if len(far) >= MIN_POINTS:
            # With the covariances of the points' neighbourhoods.
            cloud, _ = small_gicp.preprocess_points(
                far, downsampling_resolution=DOWNSAMPLED_M, num_threads=1
            )
        if cloud is not None and target is not None:
            for guess in (step, *OTHER_STEPS):
                pose = _aligned(small_gicp, target, cloud, poses[-1] @ guess)
                back = np.linalg.inv(pose) @ poses[-1]
                if overlap(before, far, back) >= MIN_OVERLAP:
                    break
                pose = None
        if pose is None:
            target, step = small_gicp.GaussianVoxelMap(MAP_VOXEL_M), np.eye(4)
            target.set_lru(horizon=MAP_SCANS)
            pose = np.eye(4)
            pose[0, 3] = PART_M + max(each[0, 3] for each in poses) if poses else 0
        else:
            step = np.linalg.inv(poses[-1]) @ pose
        if cloud is not None:
            target.insert(cloud, pose)
        poses.append(pose)
        before = far
    return np.array(poses).reshape(-1, 4, 4)


def _aligned(small_gicp: Any, target: Any, cloud: Any, guess: Poses) -> Poses:
    """Return the pose of a cloud in the map; where none is found, it is anywhere."""
    result = small_gicp.align(
        target,
        cloud,
        init_T_target_source=guess,
        max_correspondence_distance=MAX_CORRESPONDENCE_M,
        num_threads=1,
    )
    pose: Poses = result.T_target_source
    return pose if np.isfinite(pose).all() else guess
