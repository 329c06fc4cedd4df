# SPDX-License-Identifier: MIT
"""Check of the poses of a drive: they bring its scans to lie on each other, at least in parts."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from salsanext_cli.errors import FormatError
from salsanext_cli.fusion.poses import CALIBRATION, Points, Poses, with_w_first

Parts = npt.NDArray[np.int64]  # (N,): number of the part of a drive that each scan is of
ReadPoints = Callable[[int], Points]  # From the number of a scan to its measured points (M, 3)

NEAR_M, FAR_M, ABOVE_GROUND_M, GROUND_PERCENTILE = 3.0, 30.0, 0.5, 40
"""Points that tell whether two scans lie on each other: near, and not of the ground."""
THINNED = 2  # Every so many of these points of one scan are looked up in the other
MIN_UPRIGHT = 100  # Fewer such points tell nothing
COLUMN_M, COLUMN_HEIGHT_M = 0.5, 2.0  # Edges of the voxels that both scans must have points in
GRID = (160, 160, 16)  # Voxels around a scan
MIN_OVERLAP = 0.4
"""Least share of points on each other: 0.59 or more of consecutive scans of real drives, 0.46 with
half of the lasers; half of such pairs have less than 0.31 at the same place, 0.2 when turned."""
OVERLAP_REACH_M = 8.0  # Scans farther apart share the less, the farther they are
SURE_OVERLAP = 0.75  # Share from which on no other pose is looked at
MARGIN = 0.1  # Least gain in overlap by another pose, which is then the right one
COMPARED_M, COMPARED_SCANS = 5.0, 10  # Farthest earlier scan to compare with: drives may be slow
OUT_OF_SIGHT_M = 50.0  # Distance from which on two scans are not compared
MAX_MISFIT = 1 / 3  # Poses are refused above this share of scans between pairs that do not fit
SAMPLED_PAIRS = 8
CAMERA = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
"""From x forward, y left, z up to the camera's x right, y down, z forward."""


def upright_points(points: Points) -> Points:
    """Return the points (U, 3) of a scan (M, 3) that tell whether another one lies on it."""
    distance = np.hypot(points[:, 0], points[:, 1])
    is_near = (distance > NEAR_M) & (distance < FAR_M) & np.isfinite(points[:, 2])
    if not is_near.any():
        return points[:0]
    ground = np.percentile(points[is_near, 2], GROUND_PERCENTILE)
    return points[(distance > NEAR_M) & (points[:, 2] > ground + ABOVE_GROUND_M)]


def overlap(points: Points, others: Points, pose: Poses) -> float:
    """Return which share of a scan's upright points (U, 3) lies on those of another (V, 3).

    `pose`: (4, 4) from the first to the second.
    """
    grid = np.zeros(GRID, bool)
    # The outermost voxels are of points beyond the grid.
    grid[_voxels(others)] = True
    grid[[0, -1]] = grid[:, [0, -1]] = grid[:, :, [0, -1]] = False
    near = points[np.hypot(points[:, 0], points[:, 1]) < FAR_M][::THINNED]
    if not len(near):
        return 0.0
    return float(grid[_voxels(near @ pose[:3, :3].T + pose[:3, 3])].mean())


def _voxels(points: Points) -> tuple[Parts, ...]:
    size, grid = np.array([COLUMN_M, COLUMN_M, COLUMN_HEIGHT_M]), np.array(GRID)
    return tuple(np.clip(np.floor(points / size) + grid // 2, 0, grid - 1).astype(np.int64).T)


@dataclass(slots=True)
class CheckedPart:
    """Part of a drive that may go on: its last scans that tell whether another lies on them."""

    number: int
    scans: list[tuple[int, Points]] = field(default_factory=list)  # Number, upright points

    def compared(self, poses: Poses, index: int) -> tuple[int, Points]:
        """Return the scan to compare another with: the last, or one before that is not far."""
        for number, upright in self.scans:
            if index - number <= COMPARED_SCANS and _apart(poses, number, index) <= COMPARED_M:
                return number, upright
        return self.scans[-1]


def fitting_parts(poses: Poses, read: ReadPoints) -> tuple[Parts, float]:
    """Return the parts of a drive in which each scan lies on those before, and the misfit.

    That is the share of the scans that lie between two that do not fit, but are near by their
    poses. One scan that does not fit is a part of its own, and the one before goes on behind it;
    a scan whose points tell nothing goes on with the last part, unless it is far.
    """
    numbers = np.zeros(len(poses), np.int64)
    parts: list[CheckedPart] = []
    misfit = 0
    for index in range(len(poses)):
        upright = upright_points(read(index))
        is_blank = len(upright) < MIN_UPRIGHT
        if is_blank and index and _apart(poses, index - 1, index) < OUT_OF_SIGHT_M:
            numbers[index] = numbers[index - 1]
            continue
        fitting = (each for each in parts if not is_blank and _fits(each, poses, index, upright))
        part = next(fitting, None)
        if part is None:
            if parts and not is_blank:
                before, _ = parts[0].compared(poses, index)
                is_near = _apart(poses, before, index) < OUT_OF_SIGHT_M
                misfit += index - before if is_near else 0
            part = CheckedPart(numbers.max() + 1 if index else 0)
        part.scans = [*part.scans[1 - COMPARED_SCANS :], (index, upright)]
        # The last one and the one before.
        parts = [part, *(each for each in parts[:2] if each is not part)]
        numbers[index] = part.number
    return numbers, misfit / max(len(poses) - 1, 1)


def _apart(poses: Poses, one: int, other: int) -> float:
    return float(np.linalg.norm(poses[one, :3, 3] - poses[other, :3, 3]))


def _fits(part: CheckedPart, poses: Poses, index: int, upright: Points) -> bool:
    before, others = part.compared(poses, index)
    step = np.linalg.inv(poses[before]) @ poses[index]
    if len(others) < MIN_UPRIGHT:
        return _apart(poses, before, index) < OUT_OF_SIGHT_M
    share = overlap(upright, others, step)
    if share < min_overlap(step):
        return False
    if share >= SURE_OVERLAP:
        return True
    # Along a row of houses any step fits more or less.
    going_on = poses[index - 1] @ np.linalg.inv(poses[index - 2]) @ poses[index - 1]
    steps = [np.eye(4)] if index < 2 else [np.eye(4), np.linalg.inv(poses[before]) @ going_on]
    return max(overlap(upright, others, each) for each in steps) <= share + MARGIN


def min_overlap(step: Poses) -> float:
    """Return the least overlap of two scans that fit, by the pose (4, 4) of one in the other."""
    distance = float(np.linalg.norm(step[:3, 3]))
    if distance >= OUT_OF_SIGHT_M:
        return np.inf
    return MIN_OVERLAP * min(1.0, OVERLAP_REACH_M / max(distance, OVERLAP_REACH_M))


def require_fitting(path: Path, poses: Poses, read: ReadPoints) -> Parts:
    """Return the parts of a drive by given poses; refuse poses that do not fit too many scans."""
    parts, misfit = fitting_parts(poses, read)
    if misfit <= MAX_MISFIT and 2 * len(np.unique(parts)) <= len(poses) + 1:
        return parts
    better = _better_reading(poses, read)
    if misfit <= MAX_MISFIT and better is None:
        return parts
    found = f"poses that {better or f'do not fit {misfit:.0%} of the scans'}"
    hint = "leave the poses out to have them computed"
    if better == "are of the camera":
        hint = f"put the {CALIBRATION} of the drive beside them, or {hint}"
    raise FormatError(path, found, "poses from each scan to the world, in metres", hint)


def _better_reading(poses: Poses, read: ReadPoints) -> str | None:
    """Return what the poses are if read otherwise they bring scans to lie on each other."""
    to_scan = np.linalg.inv(CAMERA)
    readings = {
        "": poses,
        "are from the world to the scans": np.linalg.inv(poses),
        "are of the camera": to_scan @ poses @ CAMERA,
        f"are of the scans, not of the camera of {CALIBRATION}": CAMERA @ poses @ to_scan,
        "have w first in their quaternions, not last": with_w_first(poses),
        # The last 1 is scaled too, which cancels in the step from one pose to another.
        "are in centimetres": poses * [1, 1, 1, 0.01],
        "are in millimetres": poses * [1, 1, 1, 0.001],
    }
    shares = dict(zip(readings, _mean_overlaps([*readings.values()], read), strict=True))
    best = max(shares, key=lambda name: shares[name])
    is_better = shares[best] >= max(MIN_OVERLAP, shares[""] + MARGIN)
    return best if best and is_better else None


def best_reading(readings: Sequence[Poses], read: ReadPoints) -> int:
    """Return which reading, the first of equals, brings scans to lie on each other best."""
    if len(readings) == 1 or len(readings[0]) < 2:
        return 0
    return int(np.argmax(_mean_overlaps(readings, read)))


def _mean_overlaps(readings: Sequence[Poses], read: ReadPoints) -> npt.NDArray[np.float64]:
    """Return the mean overlap of a sample of neighbouring scans by each reading of their poses."""
    firsts = np.unique(np.linspace(0, len(readings[0]) - 2, SAMPLED_PAIRS).astype(int))
    shares = np.zeros(len(readings))
    for first in firsts:
        points, others = (upright_points(read(index)) for index in (first + 1, first))
        steps = (np.linalg.inv(poses[first]) @ poses[first + 1] for poses in readings)
        shares += [overlap(points, others, step) for step in steps]
    return shares / len(firsts)
