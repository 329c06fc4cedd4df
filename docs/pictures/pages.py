# SPDX-License-Identifier: MIT
"""Show what `report` writes for the demonstration, and `picture` for a real scan."""

from __future__ import annotations

import contextlib
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

from measurements import salsanext
from prepared import predicted_drive

from pictures.example import SCAN
from pictures.shrink import shrink

WIDTH_PX = 680
"""Width of the window: the page is then legible on a telephone and in the column of the site."""
PICTURE_WIDTH_PX = 1600
"""Width of what `picture` draws, whose text is small."""
SECTIONS = ("run", "list", "scans", "drive", "plots")
"""Sections of the page: what was run, table of scans, scan in 3-D, drive, plots."""


def report(_: Path, picture: Path) -> None:
    """Show how the page of the demonstration begins."""
    with tempfile.TemporaryDirectory() as temporary:
        page = demonstration(Path(temporary))
        screenshot(page, picture, ("run", "list"), height=1510)


def report_scan(_: Path, picture: Path) -> None:
    """Show the scan in 3-D of the page of the demonstration."""
    with tempfile.TemporaryDirectory() as temporary:
        page = demonstration(Path(temporary))
        screenshot(page, picture, ("scans",), height=1230)


def report_without_labels(data: Path, picture: Path) -> None:
    """Show what was run, and the scan in 3-D, of a drive without labels: the first tutorial."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary, "example")  # The page shows this name.
        folder.mkdir()
        with contextlib.chdir(folder):  # The page shows a command with relative paths.
            predicted_drive(data, Path(), "--error")
            salsanext("report", "out")
        screenshot(folder / "out/report.html", picture, ("run", "scans"), height=1900)


def demonstration(folder: Path) -> Path:
    """Run the demonstration in a folder; return its page, the live example of the site."""
    with contextlib.chdir(folder):  # The page shows a command with relative paths.
        salsanext("demo", "demo")
    return folder / "demo/out/report.html"


def screenshot(page: Path, picture: Path, sections: Sequence[str], height: int) -> None:
    """Write a screenshot of some sections of a page as WebP, with Chromium.

    Parameters
    ----------
    page : Path
        Page of `report`.
    picture : Path
        WebP file to write.
    sections : sequence of str
        `SECTIONS` to show; the others are hidden.
    height : int
        Height in pixels.
    """
    html = page.read_text("utf-8")
    hidden = [f"#{name}" for name in SECTIONS if name not in sections]
    for name in sections:
        # A page without the section would give an empty picture.
        if f'<section id="{name}"' not in html:
            message = f"{page}: no section {name}"
            raise ValueError(message)
    style = f"<style>{', '.join(hidden)} {{ display: none; }}</style>"
    partial = page.with_name("partial.html")
    partial.write_text(html.replace("</head>", f"{style}</head>", 1), "utf-8")
    png = page.with_name("page.png")
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or "chromium"
    options = ("--headless", "--no-sandbox", "--hide-scrollbars", "--use-gl=swiftshader")
    wait = ("--virtual-time-budget=20000", f"--window-size={WIDTH_PX},{height}")
    command = [chromium, *options, "--enable-unsafe-swiftshader", *wait, f"--screenshot={png}"]
    subprocess.run([*command, partial.as_uri()], check=True, capture_output=True, timeout=180)
    shrink(png, picture, WIDTH_PX)


def picture(data: Path, target: Path) -> None:
    """Draw a scan with its classes and its probability of error, as the page asks for it."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        _, results = predicted_drive(data, folder, "--error")
        colours = ("--colour", "label", "--colour", "uncertainty")
        salsanext("picture", folder / "out", "--limit", 1, *colours)
        shrink(results / "pictures" / f"{SCAN}.png", target, PICTURE_WIDTH_PX)
