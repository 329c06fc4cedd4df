# SPDX-License-Identifier: MIT
"""Poses of the scans of a drive: files of KITTI and TUM, and whether they fit the scans."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from salsanext_cli.errors import FormatError, counted
from salsanext_cli.files.reading import present, reading
from salsanext_cli.fusion.votes import keys_of
from salsanext_cli.records import Float

Points = npt.NDArray[np.float64] | Float
"""(N, 3), metres."""
Poses = npt.NDArray[np.float64]
"""(N, 4, 4), or (4, 4) of one: from the frame of each scan to that of the drive, metres."""
POSES, CALIBRATION, DRIVE = "poses.txt", "calib.txt", "drive.json"
KITTI_NUMBERS, TUM_NUMBERS = 12, 8
MAX_SHEAR = 1e-2
"""Largest difference of a rotation times its transpose from 1."""
MAX_STEP_M = 50.0
"""Distance of consecutive scans from which on they share no places."""
GAP_STEPS, MIN_GAP_M = 4.0, 10.0
"""A gap in a drive is a step of so many long ones, and at least so long."""
CHECKED_PAIRS = 8
NEAR_M, FAR_M, ABOVE_GROUND_M = 3.0, 30.0, 0.5
"""Points that tell whether two scans lie on each other: near, and not of the ground."""
OVERLAP_VOXEL_M = 0.5
MIN_OVERLAP = 0.35
"""Least share of such points on each other: 0.64 or more of real drives, 0.32 without poses."""
MARGIN = 0.1
"""Least gain in overlap of another reading of poses that is said to be the right one."""
CAMERA = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
"""From x forward, y left, z up to the camera's x right, y down, z forward."""


def line_numbers(path: Path, lines: int, scans: Sequence[str], wanted: Sequence[str]) -> list[int]:
    """Return the numbers of the lines of the wanted ones of all scans of a sequence, sorted stems.

    A file with a line for each scan that is there is in the order of their names; in another one,
    as KITTI's of a whole drive, a scan's name is the number of its line, from 0.
    """
    if lines == len(scans):
        places = {name: number for number, name in enumerate(scans)}
        numbers = [places[name] for name in wanted]
    else:
        numbers = [int(name) if name.isdecimal() else lines for name in wanted]
    if max(numbers, default=-1) >= lines:
        expected = f"one for each of {counted(len(scans), 'scan')}, or names that are line numbers"
        raise FormatError(path, counted(lines, "line"), expected)
    return numbers


def read_poses(path: Path, scans: Sequence[str], wanted: Sequence[str]) -> Poses:
    """Read the poses of some of the scans of a sequence, given by sorted stems.

    A line is of KITTI, 3 × 4 numbers row by row, or of TUM: time, place and quaternion x, y, z, w.
    KITTI's are of the camera where a `calib.txt` beside them has ``Tr``, from scan to camera.
    """
    rows = [line for line in _lines(path) if not line.startswith("#")]
    numbers = line_numbers(path, len(rows), scans, wanted)
    values = [_numbers(path, number, rows[number]) for number in numbers]
    poses = np.tile(np.eye(4), (len(values), 1, 1))
    for number, row, pose in zip(numbers, values, poses, strict=True):
        if len(row) == KITTI_NUMBERS:
            pose[:3] = row.reshape(3, 4)
        else:
            pose[:3, :3], pose[:3, 3] = _rotation(row[4:]), row[1:4]
        if not np.abs(pose[:3, :3] @ pose[:3, :3].T - np.eye(3)).max() < MAX_SHEAR:
            raise FormatError(path, f"line {number + 1} is no rotation", "rigid poses")
        if np.linalg.det(pose[:3, :3]) < 0:
            raise FormatError(path, f"line {number + 1} mirrors the scan", "rigid poses")
    calibration = path.with_name(CALIBRATION)
    if present(calibration) and values and len(values[0]) == KITTI_NUMBERS:
        to_camera = _calibration(calibration)
        poses = np.linalg.inv(to_camera) @ poses @ to_camera
    return poses


def read_fused_poses(path: Path, scans: Sequence[str], wanted: Sequence[str]) -> Poses:
    """Read poses that `fuse` wrote, which has a line for each scan: no name is a line's number."""
    scans, wanted = ([f"scan {name}" for name in names] for names in (scans, wanted))
    return read_poses(path, scans, wanted)


def _lines(path: Path) -> list[str]:
    with reading(path) as file:
        content = file.read().decode("utf-8", "replace")
    return [line.strip() for line in content.splitlines() if line.strip()]


def _numbers(path: Path, number: int, line: str) -> Poses:
    try:
        row = np.array([float(word) for word in line.replace(",", " ").split()])
    except ValueError:
        row = np.zeros(0)
    if len(row) not in (KITTI_NUMBERS, TUM_NUMBERS) or not np.isfinite(row).all():
        expected = "12 finite numbers (KITTI) or 8 (TUM)"
        raise FormatError(path, f"line {number + 1}: {line[:60]!r}", expected)
    return row


def _rotation(quaternion: Poses) -> Poses:
    """Return the rotation (3, 3) of a quaternion x, y, z, w."""
    x, y, z, w = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def _calibration(path: Path) -> Poses:
    """Return ``Tr`` (4, 4), from scan to camera."""
    for line in _lines(path):
        name, _, values = line.partition(":")
        if name in ("Tr", "Tr_velo_to_cam", "Tr_velo_cam"):
            row = _numbers(path, 0, values)
            if len(row) == KITTI_NUMBERS:
                return np.vstack([row.reshape(3, 4), [0, 0, 0, 1]])
    raise FormatError(path, "no line Tr", "12 numbers from scan to camera, or no such file")


def encode_poses(poses: Poses) -> bytes:
    """Return poses as KITTI writes them, one of 12 numbers per line."""
    rows = (" ".join(f"{value:.12e}" for value in pose[:3].ravel()) for pose in poses)
    return "".join(f"{row}\n" for row in rows).encode("ascii")


def segments(poses: Poses) -> npt.NDArray[np.int64]:
    """Return the part of a drive (N,) that each scan is of; too long a step begins another."""
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    # A drive may stand most of the time.
    usual = float(np.percentile(steps, 90)) if len(steps) else 0.0
    gaps = (steps > MAX_STEP_M) | ((steps > MIN_GAP_M) & (steps > GAP_STEPS * usual))
    return np.concatenate([[0], np.cumsum(gaps)])


def overlap(points: Points, others: Points, pose: Poses) -> float:
    """Return which share of a scan's upright points near the sensor lies on those of another.

    `points`, `others`: (N, 3), (M, 3) metres, each in its own frame; `pose`: (4, 4) from the first
    to the second.
    """
    upright = _upright(points)
    if not len(upright):
        return 0.0
    keys = keys_of(upright @ pose[:3, :3].T + pose[:3, 3], OVERLAP_VOXEL_M)
    occupied = np.unique(keys_of(others.astype(np.float64), OVERLAP_VOXEL_M))
    return float(np.isin(keys, occupied).mean())


def _upright(points: Points) -> Poses:
    distance = np.hypot(points[:, 0], points[:, 1])
    near = points[(distance > NEAR_M) & (distance < FAR_M)].astype(np.float64)
    if not len(near):
        return near
    upright: Poses = near[near[:, 2] > np.percentile(near[:, 2], 40) + ABOVE_GROUND_M]
    return upright


def require_fitting(
    path: Path, poses: Poses, parts: npt.NDArray[np.int64], read: Callable[[int], Float]
) -> None:
    """Refuse poses by which consecutive scans do not come to lie on each other.

    `read`: returns the points (N, 3) of a scan by its number.
    """
    pairs = np.flatnonzero(np.diff(parts) == 0)
    # Poses in another unit may put all scans apart.
    pairs = pairs if len(pairs) else np.arange(len(poses) - 1)
    if not len(pairs):
        return
    chosen = np.unique(pairs[np.linspace(0, len(pairs) - 1, CHECKED_PAIRS).astype(int)])
    readings = {
        "": poses,
        "are from the world to the scans": np.linalg.inv(poses),
        "are of the camera": np.linalg.inv(CAMERA) @ poses @ CAMERA,
        "are in centimetres": _scaled(poses, 0.01),
        "are in millimetres": _scaled(poses, 0.001),
        "fit worse than none": np.tile(np.eye(4), (len(poses), 1, 1)),
    }
    shares = dict.fromkeys(readings, 0.0)
    for first in chosen:
        points, others = read(first), read(first + 1)
        for name, each in readings.items():
            step = np.linalg.inv(each[first + 1]) @ each[first]
            shares[name] += overlap(points, others, step) / len(chosen)
    best = max(shares, key=lambda name: shares[name])
    if shares[best] < shares[""] + MARGIN:
        best = ""
    is_apart = (np.diff(parts) > 0).all() and not best
    if (best and shares[best] >= MIN_OVERLAP) or (shares[""] < MIN_OVERLAP and not is_apart):
        found = f"poses that {best or 'do not fit the scans'}: {shares['']:.0%} of the points meet"
        expected = "poses from each scan to the world, in metres"
        remedy = "leave the poses out to have them computed"
        if best == "are of the camera":
            remedy = f"put the {CALIBRATION} of the drive beside them, or {remedy}"
        raise FormatError(path, found, expected, remedy)


def _scaled(poses: Poses, factor: float) -> Poses:
    scaled = poses.copy()
    scaled[:, :3, 3] *= factor
    return scaled
