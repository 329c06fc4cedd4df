# SPDX-License-Identifier: MIT
"""Show what `report` writes for the demonstration, and `picture` for a real scan."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from pathlib import Path

from measurements import salsanext
from prepared import predicted_drive

from pictures.example import SCAN
from pictures.shrink import shrink

WINDOW = "1000,1540"
WIDTH_PX = 1000
PICTURE_WIDTH_PX = 1600
"""Width of what `picture` draws, whose text is small."""


def report(_: Path, picture: Path) -> None:
    """Take a screenshot of the page of the demonstration, the live example of the site."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        salsanext("demo", folder / "demo")
        screenshot(folder / "demo/out/report.html", folder / "page.png")
        shrink(folder / "page.png", picture, WIDTH_PX)


def report_without_labels(data: Path, picture: Path) -> None:
    """Take a screenshot of the page of a drive without labels, that of the first tutorial."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary, "example")  # The page shows its name.
        folder.mkdir()
        predicted_drive(data, folder)
        salsanext("report", folder / "out")
        screenshot(folder / "out/report.html", folder / "page.png")
        shrink(folder / "page.png", picture, WIDTH_PX)


def screenshot(page: Path, png: Path, window: str = WINDOW) -> None:
    """Write a screenshot of a page, in Chromium."""
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or "chromium"
    options = ("--headless", "--no-sandbox", "--hide-scrollbars", "--use-gl=swiftshader")
    wait = ("--virtual-time-budget=20000", f"--window-size={window}", f"--screenshot={png}")
    command = [chromium, *options, "--enable-unsafe-swiftshader", *wait, page.as_uri()]
    subprocess.run(command, check=True, capture_output=True, timeout=180)


def picture(data: Path, target: Path) -> None:
    """Draw a scan with its classes and its probability of error, as the page asks for it."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        _, results = predicted_drive(data, folder, "--error")
        colours = ("--colour", "label", "--colour", "uncertainty")
        salsanext("picture", folder / "out", "--limit", 1, *colours)
        shrink(results / "pictures" / f"{SCAN}.png", target, PICTURE_WIDTH_PX)
