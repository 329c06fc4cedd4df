# SPDX-License-Identifier: MIT
"""Record of the poses by which the scans of a drive were fused, beside their labels."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from salsanext_cli.errors import OutputError
from salsanext_cli.files.json_files import read_json
from salsanext_cli.files.reading import present, refusing_damage
from salsanext_cli.fusion.pose_checks import Parts
from salsanext_cli.fusion.poses import POSES, Poses, encode_poses, read_fused_poses

DRIVE = "drive.json"


@dataclass(frozen=True, slots=True)
class Drive:
    """Poses (N, 4, 4) of the scans of a drive, and the parts (N,) that they fit in."""

    poses: Poses
    parts: Parts

    @property
    def origins(self) -> Poses:
        """Place (P, 3) of the first scan of each part; far from it, voxels have no digits."""
        origins = np.zeros((self.parts.max(initial=-1) + 1, 3))
        origins[self.parts[::-1]] = self.poses[::-1, :3, 3]
        return origins

    def record(self, stems: Sequence[str]) -> dict[str, object]:
        """Return what is recorded of a drive whose scans have such stems."""
        digest = hashlib.sha256(encode_poses(self.poses)).hexdigest()
        return {"scans": [*stems], "poses": digest, "parts": self.parts.tolist()}


def recorded_drive(folder: Path, wanted: Sequence[str] | None = None) -> Drive | None:
    """Return the drive by which `fuse` wrote the labels in the folder of a sequence.

    `wanted`: stems, all by default. None if no scans were fused, or others.
    """
    record, path = read_json(folder / DRIVE), folder / POSES
    if record is None or not present(path):
        return None
    with refusing_damage(folder / DRIVE, "the record of `fuse`"):
        stems, parts = [*map(str, record["scans"])], np.array(record.get("parts", ()), np.int64)
        drive = Drive(read_fused_poses(path, stems, stems), parts)
    wanted = stems if wanted is None else wanted
    if drive.record(stems) != record:
        hint = "fuse the sequence anew with --overwrite"
        raise OutputError(path, "not the poses that the scans were fused by", hint=hint)
    numbers = {stem: number for number, stem in enumerate(stems)}
    if not numbers.keys() >= {*wanted}:
        return None
    chosen = [numbers[stem] for stem in wanted]
    return Drive(drive.poses[chosen], parts[chosen])
