# SPDX-License-Identifier: MIT
"""Where the scans of a run are, and the day of its results, in words."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

from salsanext_cli.core.texts import counted
from salsanext_cli.report.page.run_results import RunResults
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.runs.scans.layouts import SCAN_FOLDER

DATED_FOLDERS = ("predictions", "uncertainty")
"""Folders, in those of sequences, whose files date a page."""


def run_source(run: RunResults) -> str:
    """Return the folder of the scans and the day of their results, in words."""
    folders = list(dict.fromkeys(row.file.path.parent for row in run.rows))
    parts = folders[0].parts
    text = "scans: " + "/".join(parts[-4:] if parts[-1] == SCAN_FOLDER else parts[-1:])
    if len(folders) > 1:
        text += f" and {counted(len(folders) - 1, 'more folder')}"
    day = _day_of_results(run.reader.out)
    if day:
        text += f" · results of {day}"
    return text


def _day_of_results(out: Path) -> str:
    """Return the day when the last result was written, by the list of written files.

    Empty without such a list. A copy of a folder has the list; its files may have other times.
    """
    times_ns = [
        state.time_ns
        for path, states in OwnedFolder(out).states().items()
        if _folder_of_sequence(path.relative_to(out)) in DATED_FOLDERS
        for state in states
    ]
    if not times_ns:
        return ""
    return datetime.fromtimestamp(max(times_ns) / 1e9, UTC).astimezone().date().isoformat()


def _folder_of_sequence(path: Path) -> str:
    """Return the name of the folder below `sequences/00` that a path leads into; else empty."""
    return path.parts[2] if len(path.parts) > 2 else ""
