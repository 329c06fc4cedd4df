# SPDX-License-Identifier: MIT
"""Record of the drive by which a sequence was fused, beside its poses."""

import hashlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from salsanext_cli.core.errors import OutputError
from salsanext_cli.core.fusion.drive import Drive
from salsanext_cli.core.poses import POSES
from salsanext_cli.core.records import Double
from salsanext_cli.core.wording import setting
from salsanext_cli.io.files.json_files import read_json
from salsanext_cli.io.files.reading import present, refusing_damage
from salsanext_cli.io.poses import encode_poses, read_fused_poses

DRIVE = "drive.json"


def recorded_drive(folder: Path) -> Drive | None:
    """Return the drive that `fuse` recorded in the folder of a sequence, None without one."""
    record = read_json(folder / DRIVE)
    path = folder / POSES
    if record is None or not present(path):
        return None
    with refusing_damage(folder / DRIVE, "the record of `fuse`"):
        stems = [str(stem) for stem in record["scans"]]
        parts = np.array(record.get("parts", ()), np.int64)
        drive = Drive(read_fused_poses(path, stems), parts)
    if drive_record(drive, stems) != record:
        problem = "differs from the poses that the scans were fused by"
        hint = f"fuse the sequence again with {setting('overwrite', True)}"
        raise OutputError(path, problem, hint=hint)
    return drive


def drive_record(drive: Drive, stems: Sequence[str]) -> dict[str, object]:
    """Return the record of the drive, whose scans have these stems."""
    digest = hashlib.sha256(encode_poses(drive.poses)).hexdigest()
    return {"scans": [*stems], "poses": digest, "parts": drive.parts.tolist()}


def poses_of_largest_part(folder: Path) -> dict[str, Double]:
    """Return the poses (4, 4) of the scans of the largest part of a recorded drive, by stem.

    Raises
    ------
    OutputError
        If the record or the poses are missing, damaged or changed.
    """
    drive = recorded_drive(folder)
    record = read_json(folder / DRIVE)
    if drive is None or record is None:
        missing = folder / (DRIVE if record is None else POSES)
        hint = f"fuse the sequence again with {setting('overwrite', True)}"
        raise OutputError(missing, "is missing", hint=hint)
    largest = np.bincount(drive.parts).argmax()
    poses: dict[str, Double] = {}
    for stem, pose, part in zip(record["scans"], drive.poses, drive.parts, strict=True):
        if part == largest:
            poses[str(stem)] = pose
    return poses
