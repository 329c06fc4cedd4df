# SPDX-License-Identifier: MIT
"""Show what `report` and `picture` write for the drive that training has not seen."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from pathlib import Path

from measurements import salsanext
from prepared import predicted_drive

from pictures.concepts import SCAN, TRUTH
from pictures.shrink import shrink

WINDOW = "1280,2080"
WIDTH_PX = 1280
SCANS_SHOWN = 4  # So that the picture has the table of scans and a scan


def report(data: Path, picture: Path) -> None:
    """Take a screenshot of the page of a run, in Chromium."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary, "example")  # The page shows its name.
        folder.mkdir()
        predicted_drive(data, folder, "--error")
        salsanext("report", folder / "out", "--limit", SCANS_SHOWN)
        screenshot(folder / "out/report.html", folder / "page.png")
        shrink(folder / "page.png", picture, WIDTH_PX)


def screenshot(page: Path, png: Path, window: str = WINDOW) -> None:
    """Write a screenshot of a page."""
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or "chromium"
    options = ("--headless", "--no-sandbox", "--hide-scrollbars", "--use-gl=swiftshader")
    wait = ("--virtual-time-budget=20000", f"--window-size={window}", f"--screenshot={png}")
    command = [chromium, *options, "--enable-unsafe-swiftshader", *wait, page.as_uri()]
    subprocess.run(command, check=True, capture_output=True, timeout=180)


def picture(data: Path, target: Path) -> None:
    """Draw a scan with truth, prediction, wrong labels and uncertainty."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        scans, results = predicted_drive(data, folder, "--error")
        labels = folder / "drive/labels"
        labels.mkdir()
        for scan in scans:
            shutil.copy(data / TRUTH / f"{scan.stem}.label", labels)
        colours = [f"--colour={name}" for name in ("truth", "label", "wrong", "uncertainty")]
        salsanext("picture", folder / "out", "--limit", 1, *colours)
        shrink(results / "pictures" / f"{SCAN}.png", target, 1600)
