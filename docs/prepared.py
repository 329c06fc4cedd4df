# SPDX-License-Identifier: MIT
"""Prepare the scans that the guides name: of the real data, or simulated ones for the tests."""

from __future__ import annotations

import shutil
from pathlib import Path

from guide import run

DRIVE = "pandaset/sequences/002/velodyne"
"""Drive of a Pandar64; training has not seen its last ten scans."""
SCANS = 10


def prepared_folder(folder: Path, data: Path | None) -> None:
    """Write `drive/`, a folder of scans without labels, and `semantickitti/`, labelled sequences."""
    if data is None:
        run("salsanext synth semantickitti --train 2 --valid 1 --test 1 --scans 2 --seed 3", folder)
        shutil.copytree(folder / "semantickitti/sequences/00/velodyne", folder / "drive")
        return
    (folder / "drive").mkdir()
    for scan in sorted((data / DRIVE).iterdir())[-SCANS:]:
        shutil.copy(scan, folder / "drive")
    (folder / "semantickitti").symlink_to(data / "semantickitti")
