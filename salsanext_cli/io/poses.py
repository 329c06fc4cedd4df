# SPDX-License-Identifier: MIT
"""Poses of the scans of a drive, in files of KITTI and TUM."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from salsanext_cli.core.errors import FormatError
from salsanext_cli.core.poses import CALIBRATION, POSES, Poses, rotation
from salsanext_cli.core.texts import counted
from salsanext_cli.core.wording import setting
from salsanext_cli.io.files.reading import present, reading

KITTI_NUMBERS = 12
TUM_NUMBERS = 8
MAX_SHEAR = 1e-2  # Largest difference from 1 of a rotation times its transpose
MAX_COORDINATE_M = 1e12  # Bound up to which float64 resolves millimetres
ROUNDED = 1e-12  # Largest difference from 1 of the singular values of an exact rotation


def line_numbers(
    path: Path, lines: int, scans: Sequence[str], names: Sequence[str]
) -> list[list[int]]:
    """Return the possible line numbers of scans in a file of poses.

    A file with a line for each scan is in the order of their names. In any other file, as KITTI's
    of a whole drive, the name of a scan is the number of its line, counted from 0, or possibly from
    1 if no scan is named 0.

    Parameters
    ----------
    path : Path
        The file, in errors.
    lines : int
        Number of its lines.
    scans : sequence of str
        Sorted names of all scans of the sequence.
    names : sequence of str
        Names of the scans to return the lines of.

    Returns
    -------
    list of list of int
        One or two possible numbers of the line of each name, from 0.

    Raises
    ------
    FormatError
        If a name is beyond the last line counted from 0, or no number.
    """
    if lines == len(scans):
        places = {name: number for number, name in enumerate(scans)}
        numbers = [places.get(name, -1) for name in names]
    else:
        numbers = [int(name) if name.isdecimal() else -1 for name in names]
    if not all(0 <= number < lines for number in numbers):
        expected = f"one for each of {counted(len(scans), 'scan')}, or names that are line numbers"
        raise FormatError(path, f"has {counted(lines, 'line')}", expected)
    may_count_from_1 = lines != len(scans) and all(n.isdecimal() and int(n) for n in scans)
    return [numbers, [number - 1 for number in numbers]] if may_count_from_1 else [numbers]


def pose_readings(path: Path, scans: Sequence[str], names: Sequence[str]) -> list[Poses]:
    """Read the poses of scans of a sequence.

    A line of KITTI is a matrix (3, 4), row by row; a line of TUM is time, position and quaternion
    x, y, z, w. Poses of KITTI are those of the camera if a `calib.txt` in the same folder has
    ``Tr``, from scan to camera.

    Parameters
    ----------
    path : Path
        File of KITTI or TUM.
    scans : sequence of str
        Sorted names of all scans of the sequence.
    names : sequence of str
        Names of N scans to read.

    Returns
    -------
    list of (N, 4, 4) float64
        Poses in metres for each result of `line_numbers`.

    Raises
    ------
    FormatError
        If the file is damaged, or contains no rigid poses.
    """
    rows = [line for line in _lines(path) if not line.startswith("#")]
    possible = line_numbers(path, len(rows), scans, names)
    return [_poses_of_lines(path, rows, numbers) for numbers in possible]


def _poses_of_lines(path: Path, rows: Sequence[str], numbers: Sequence[int]) -> Poses:
    values = [_numbers(path, number, rows[number]) for number in numbers]
    poses = np.tile(np.eye(4), (len(values), 1, 1))
    for number, row, pose in zip(numbers, values, poses, strict=True):
        is_kitti = len(row) == KITTI_NUMBERS
        name = f"line {number + 1}"
        matrix = row if is_kitti else _matrix_of_tum(path, name, row)
        pose[:3] = _rigid(path, name, matrix)
    calibration = path.with_name(CALIBRATION)
    if present(calibration) and values and len(values[0]) == KITTI_NUMBERS:
        to_camera = _calibration(calibration)
        poses = np.linalg.inv(to_camera) @ poses @ to_camera
    return poses


def _matrix_of_tum(path: Path, name: str, row: Poses) -> Poses:
    """Return the matrix (3, 4) of a line of TUM; refuse a quaternion of another length than 1."""
    x, y, z, w = row[4:]
    length = np.linalg.norm(row[4:])
    if abs(length - 1) > MAX_SHEAR:
        problem = f"{name} has a quaternion of length {length:.3g}"
        raise FormatError(path, problem, "time, position and quaternion x, y, z, w of length 1")
    return np.column_stack([rotation(x, y, z, w), row[1:4]])


def read_fused_poses(path: Path, scans: Sequence[str]) -> Poses:
    """Read poses that `fuse` wrote, with a line for each scan whatever its name."""
    names = [f"scan {name}" for name in scans]
    (poses,) = pose_readings(path, names, names)
    return poses


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


def _rigid(path: Path, name: str, row: Poses) -> Poses:
    """Return a pose (3, 4) with the exact rotation that is nearest to the one in a file."""
    pose = row.reshape(3, 4)
    farthest = np.abs(pose[:, 3]).max()
    if farthest >= MAX_COORDINATE_M:
        problem = f"{name} has a coordinate of {farthest:.3g} m"
        raise FormatError(path, problem, "positions in metres")
    shear = np.abs(pose[:, :3] @ pose[:, :3].T - np.eye(3)).max()
    if not (shear < MAX_SHEAR and np.linalg.det(pose[:, :3]) > 0):
        raise FormatError(path, f"{name} scales, shears or mirrors the scan", "rigid poses")
    left, lengths, right = np.linalg.svd(pose[:, :3])
    if np.abs(lengths - 1).max() < ROUNDED:
        return pose
    return np.column_stack([left @ right, pose[:, 3]])


def _calibration(path: Path) -> Poses:
    """Return ``Tr`` (4, 4), from scan to camera."""
    for line in _lines(path):
        name, _, values = line.partition(":")
        if name in ("Tr", "Tr_velo_to_cam", "Tr_velo_cam"):
            row = _numbers(path, 0, values)
            if len(row) == KITTI_NUMBERS:
                return np.vstack([_rigid(path, name, row), [0, 0, 0, 1]])
    expected = "Tr, from scan to camera"
    raise FormatError(path, "has no line Tr with 12 numbers", expected, _without_tr_hint())


def _without_tr_hint() -> str:
    """Return what helps if a calibration has no ``Tr``."""
    return (
        f"copy the {CALIBRATION} that has Tr, of KITTI's calibration files or of SemanticKITTI; or "
        f"give poses of the LiDAR, in a folder without {CALIBRATION}: {setting('poses', 'FILE')}; "
        f"or rename {POSES}, and the poses are computed from the scans"
    )


def encode_poses(poses: Poses) -> bytes:
    """Return the content of a file of KITTI, 12 numbers per line, to the last digit."""
    rows = (" ".join(f"{value:.16e}" for value in pose[:3].ravel()) for pose in poses)
    return "".join(f"{row}\n" for row in rows).encode("ascii")
