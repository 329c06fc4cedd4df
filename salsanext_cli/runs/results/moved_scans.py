# SPDX-License-Identifier: MIT
"""Scans of a sequence of results, whose folder may have been moved or renamed since."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from salsanext_cli.core.errors import NoInputError
from salsanext_cli.io.files.reading import present
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.scan_search import find_scans, scans_at_top, scans_of_sequences


def recorded_scans(folder: Path, sequence: str, suffixes: Mapping[str, str]) -> list[ScanFile]:
    """Return the scans of a sequence in the folder that was recorded; none if it was moved.

    `suffixes`: those of the recorded files by stem, empty for scans of a recording.
    """
    scans = _scans_in(folder, sequence)
    listed = {scan.path.name for scan in scans}
    # Tables beside clouds are scans only if they were named.
    for stem, suffix in suffixes.items():
        name = stem + suffix
        if suffix and name not in listed and present(folder / name):
            scans.append(ScanFile(sequence=sequence, stem=stem, path=folder / name))
    return scans


def _scans_in(folder: Path, sequence: str) -> list[ScanFile]:
    """Return the scans of a sequence in a folder, which in some layouts contains several."""
    try:
        scans = scans_at_top(folder)
    except NoInputError:
        return []  # They were moved.
    scans_of_sequence = [scan for scan in scans if scan.sequence == sequence]
    # Older versions named the sequences of some layouts otherwise.
    return scans_of_sequence or [replace(scan, sequence=sequence) for scan in scans]


def scans_of_renamed(dataset: Path, sequence: str) -> list[ScanFile]:
    """Return the scans of a sequence whose folder or recording may have been renamed."""
    scans = find_scans(dataset, unique=False)
    folders = {(scan.path.parent, scan.sequence) for scan in scans}
    if len(folders) > 1:
        return scans_of_sequences(scans, [sequence], dataset)
    # The only one is the sequence, whatever its name is now.
    return [replace(scan, sequence=sequence) for scan in scans]
