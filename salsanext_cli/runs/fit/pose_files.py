# SPDX-License-Identifier: MIT
"""Files of the poses of a sequence, and positions in the coordinates of its files."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from salsanext_cli.core.poses import POSES, Poses
from salsanext_cli.core.records import Double, Origin, Scan
from salsanext_cli.io.files.reading import present
from salsanext_cli.io.formats.recordings import recorded_poses, recording_of
from salsanext_cli.io.poses import pose_readings
from salsanext_cli.runs.scans.layouts import SCAN_FOLDER
from salsanext_cli.runs.scans.scan_file import ScanFile, drive_order
from salsanext_cli.runs.scans.scan_search import find_scans


def poses_beside(files: Sequence[ScanFile]) -> Path | None:
    """Return the file of poses in the folder of a sequence, or the recording that contains them.

    None without any.
    """
    recording = recording_of(files[0].path)
    if recording is not None:
        return recording if recorded_poses(recording) is not None else None
    folder = files[0].path.parent
    path = (folder.parent if folder.name == SCAN_FOLDER else folder) / POSES
    return path if present(path) else None


def readings_of(path: Path, files: Sequence[ScanFile]) -> list[Poses]:
    """Return the possible poses (N, 4, 4) of scans in a file, as of `pose_readings`."""
    poses = recorded_poses(path)
    if poses is not None:
        return [poses[[int(file.stem) for file in files]]]
    listed = sorted(find_scans(files[0].path.parent, unique=False), key=drive_order)
    return pose_readings(path, _stems(listed), _stems(files))


def position_in_file(origin: Origin, scan: Scan) -> Double:
    """Return a position (3,) in the frame of a scan in the coordinates of its file, in metres."""
    return np.add(origin, scan.notes.frame)


def _stems(files: Sequence[ScanFile]) -> list[str]:
    """Return the stems of scans, each once, in order."""
    return list(dict.fromkeys(file.stem for file in files))
