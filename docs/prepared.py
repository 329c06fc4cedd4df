# SPDX-License-Identifier: MIT
"""Prepare the scans that the guides name: of the real data, or simulated ones for the tests."""

from __future__ import annotations

import shutil
from pathlib import Path

from guide import run
from measurements import salsanext

DRIVE = "pandaset/sequences/002/velodyne"
"""Drive of a Pandar64; training has not seen its last ten scans."""
SCANS = 10


def held_out_scans(data: Path) -> list[Path]:
    """Return the scans of the drive that training has not seen, in their order."""
    return sorted((data / DRIVE).iterdir())[-SCANS:]


def predicted_drive(data: Path, folder: Path, *options: object) -> tuple[list[Path], Path]:
    """Predict the held-out drive in a folder; return its scans and the folder of their results."""
    scans = folder / "drive"
    scans.mkdir()
    for scan in held_out_scans(data):
        shutil.copy(scan, scans)
    salsanext("predict", scans, folder / "out", *options)
    return sorted(scans.iterdir()), folder / "out/sequences/drive"


def prepared_folder(folder: Path, data: Path | None) -> None:
    """Write the scans that the guides name.

    They are `drive/`, scans without labels, `semantickitti/`, labelled sequences, and one scan,
    `000000.bin`. Without `data` they are simulated.
    """
    if data is None:
        run("salsanext synth semantickitti --train 2 --valid 1 --test 1 --scans 2 --seed 3", folder)
        shutil.copytree(folder / "semantickitti/sequences/00/velodyne", folder / "drive")
    else:
        (folder / "drive").mkdir()
        for scan in held_out_scans(data):
            shutil.copy(scan, folder / "drive")
        (folder / "semantickitti").symlink_to(data / "semantickitti")
    shutil.copy(min((folder / "drive").iterdir()), folder / "000000.bin")
