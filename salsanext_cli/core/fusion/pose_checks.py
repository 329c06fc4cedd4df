# SPDX-License-Identifier: MIT
"""Checks that the poses of a drive align its scans, at least in parts."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.errors import FormatError
from salsanext_cli.core.poses import CALIBRATION, Points, Poses
from salsanext_cli.core.records import Double
from salsanext_cli.core.texts import percentage

Parts = npt.NDArray[np.int64]  # (N,): number of the part of a drive that each scan belongs to
ReadPoints = Callable[[int], Points]  # From the number of a scan to its measured points (M, 3)

NEAR_M = 3.0  # Least level distance of upright points
FAR_M = 30.0  # Largest level distance of upright points
ABOVE_GROUND_M = 0.5  # Least height of upright points above the ground
GROUND_PERCENTILE = 40  # Percentile of the heights that is the height of the ground
THINNED = 2  # One in so many upright points of a scan is compared
MIN_UPRIGHT = 100  # Fewest upright points of a comparison
COLUMN_M = 0.5  # Width of the voxels that both scans must have points in
COLUMN_HEIGHT_M = 2.0  # Height of these voxels
GRID = (160, 160, 16)  # Voxels around a scan
MIN_OVERLAP = 0.4
"""Least overlap of scans that fit: 0.59 or more of consecutive scans of real drives, 0.46 with half
of the lasers; half of such pairs have less than 0.31 with equal poses, 0.2 with a turned one."""
OVERLAP_REACH_M = 8.0  # Distance of scans beyond which their overlap falls
SURE_OVERLAP = 0.75  # Least overlap that needs no comparison with other poses
MARGIN = 0.1  # Least gain in overlap by another pose, which is then the right one
COMPARED_M = 5.0  # Farthest scan to compare with: drives may be slow
COMPARED_SCANS = 10  # Earliest scan to compare with, counted back
OUT_OF_SIGHT_M = 50.0  # Least distance of scans that are not compared
MAX_MISFIT = 1 / 3  # Largest share of scans between pairs that do not fit
SAMPLED_PAIRS = 8


def upright_points(points: Points) -> Points:
    """Return the points (U, 3) of a scan (M, 3) that show whether another scan fits."""
    distance = np.hypot(points[:, 0], points[:, 1])
    is_near = (distance > NEAR_M) & (distance < FAR_M) & np.isfinite(points[:, 2])
    if not is_near.any():
        return points[:0]
    ground = np.percentile(points[is_near, 2], GROUND_PERCENTILE)
    return points[(distance > NEAR_M) & (points[:, 2] > ground + ABOVE_GROUND_M)]


def overlap(points: Points, others: Points, pose: Poses) -> float:
    """Return the share of upright points in voxels of the points of another scan.

    Parameters
    ----------
    points : (U, 3) array
        Upright points of a scan in metres.
    others : (V, 3) array
        Upright points of the other scan in its own frame, in metres.
    pose : (4, 4) float64
        Pose that leads from the first scan to the other.

    Returns
    -------
    float
        Share, 0…1.
    """
    grid = np.zeros(GRID, bool)
    # The outermost voxels hold points beyond the grid.
    grid[_voxels(others)] = True
    grid[[0, -1]] = False
    grid[:, [0, -1]] = False
    grid[:, :, [0, -1]] = False
    near = points[np.hypot(points[:, 0], points[:, 1]) < FAR_M][::THINNED]
    if not len(near):
        return 0.0
    return float(grid[_voxels(near @ pose[:3, :3].T + pose[:3, 3])].mean())


def _voxels(points: Points) -> tuple[Parts, ...]:
    """Return the indices of the voxel of each point (N, 3), by axis."""
    size = np.array([COLUMN_M, COLUMN_M, COLUMN_HEIGHT_M])
    grid = np.array(GRID)
    return tuple(np.clip(np.floor(points / size) + grid // 2, 0, grid - 1).astype(np.int64).T)


@dataclass(slots=True)
class CheckedPart:
    """Part of a drive, with the numbers and upright points of its last scans."""

    number: int
    scans: list[tuple[int, Points]] = field(default_factory=list)

    def compared(self, poses: Poses, index: int) -> tuple[int, Points]:
        """Return the scan to compare another with: the earliest near it, or the last."""
        for number, upright in self.scans:
            if index - number <= COMPARED_SCANS and _apart(poses, number, index) <= COMPARED_M:
                return number, upright
        return self.scans[-1]


def fitting_parts(poses: Poses, read: ReadPoints) -> tuple[Parts, float]:
    """Return the part of a drive that each scan fits, and the misfit.

    A single scan that does not fit is a part, after which the part before continues. A scan with
    few upright points continues the last part, unless it is far.

    Parameters
    ----------
    poses : (N, 4, 4) float64
        Poses of the scans in metres.
    read : callable
        Returns the measured points (M, 3) of the scan with a number.

    Returns
    -------
    parts : (N,) int64
        Number of the part of each scan.
    misfit : float
        Share of scans between two that do not fit, but are near by their poses.
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
        fitting = (p for p in parts if not is_blank and _fits(p, poses, index, upright))
        current = next(fitting, None)
        if current is None:
            if parts and not is_blank:
                before, _ = parts[0].compared(poses, index)
                is_near = _apart(poses, before, index) < OUT_OF_SIGHT_M
                misfit += index - before if is_near else 0
            current = CheckedPart(numbers.max() + 1 if index else 0)
        current.scans = [*current.scans[1 - COMPARED_SCANS :], (index, upright)]
        parts = [current] + [other for other in parts[:2] if other is not current]
        numbers[index] = current.number
    return numbers, misfit / max(len(poses) - 1, 1)


def _apart(poses: Poses, first: int, second: int) -> float:
    """Return the distance of two scans by their poses in metres."""
    return float(np.linalg.norm(poses[first, :3, 3] - poses[second, :3, 3]))


def _fits(earlier: CheckedPart, poses: Poses, index: int, upright: Points) -> bool:
    """Return whether the upright points of a scan fit an earlier part by their poses."""
    before, others = earlier.compared(poses, index)
    step = np.linalg.inv(poses[before]) @ poses[index]
    if len(others) < MIN_UPRIGHT:
        return _apart(poses, before, index) < OUT_OF_SIGHT_M
    share = overlap(upright, others, step)
    if share < min_overlap(step):
        return False
    if share >= SURE_OVERLAP:
        return True
    # Any step along a row of houses fits more or less: compare halting and going on as before.
    steps = [np.eye(4)]
    if index >= 2:
        going_on = poses[index - 1] @ np.linalg.inv(poses[index - 2]) @ poses[index - 1]
        steps.append(np.linalg.inv(poses[before]) @ going_on)
    return max(overlap(upright, others, other) for other in steps) <= share + MARGIN


def min_overlap(step: Poses) -> float:
    """Return the least overlap of scans that fit, by the pose (4, 4) of one in the other."""
    distance = float(np.linalg.norm(step[:3, 3]))
    if distance >= OUT_OF_SIGHT_M:
        return np.inf
    return MIN_OVERLAP * min(1.0, OVERLAP_REACH_M / max(distance, OVERLAP_REACH_M))


def require_fitting(source: object, poses: Poses, read: ReadPoints) -> Parts:
    """Return the parts of a drive by poses from a file.

    Parameters
    ----------
    source : object
        Name of the file in errors.
    poses : (N, 4, 4) float64
        Poses of the scans in metres.
    read : callable
        Returns the measured points (M, 3) of the scan with a number.

    Returns
    -------
    (N,) int64
        Number of the part of each scan.

    Raises
    ------
    FormatError
        If the poses fit too few scans, or are in another unit.
    """
    parts, misfit = fitting_parts(poses, read)
    if misfit > MAX_MISFIT:
        hint = f"add the {CALIBRATION} of poses of a camera, or remove the file to compute poses"
        expected = "poses from each scan to the world, in metres"
        raise FormatError(
            source, f"does not fit {percentage(misfit, 0)} of the scans", expected, hint
        )
    if 2 * len(np.unique(parts)) > len(poses) + 1:
        _require_metres(source, poses, read)
    return parts


def _require_metres(source: object, poses: Poses, read: ReadPoints) -> None:
    """Refuse poses by which the scans fit only in another unit."""
    # The last 1 is scaled too, which cancels in the step from one pose to another.
    readings = [poses, poses * [1, 1, 1, 0.01], poses * [1, 1, 1, 0.001]]
    shares = _mean_overlaps(readings, read)
    if shares.max() >= max(MIN_OVERLAP, shares[0] + MARGIN):
        unit = ("", "centimetres", "millimetres")[int(shares.argmax())]
        raise FormatError(source, f"positions in {unit}", "metres", "convert the positions")


def best_reading(readings: Sequence[Poses], read: ReadPoints) -> int:
    """Return the number of the reading by which the scans fit best, the first in a tie.

    Parameters
    ----------
    readings : sequence of (N, 4, 4) float64
        Possible poses of the same scans.
    read : callable
        Returns the measured points (M, 3) of the scan with a number.

    Returns
    -------
    int
    """
    if len(readings) == 1 or len(readings[0]) < 2:
        return 0
    return int(np.argmax(_mean_overlaps(readings, read)))


def _mean_overlaps(readings: Sequence[Poses], read: ReadPoints) -> Double:
    """Return the mean overlap, (R,), of a sample of neighbouring scans by R readings of poses."""
    firsts = np.unique(np.linspace(0, len(readings[0]) - 2, SAMPLED_PAIRS).astype(int))
    shares = np.zeros(len(readings))
    for first in firsts:
        points = upright_points(read(first + 1))
        others = upright_points(read(first))
        steps = (np.linalg.inv(poses[first]) @ poses[first + 1] for poses in readings)
        shares += [overlap(points, others, step) for step in steps]
    return shares / len(firsts)
