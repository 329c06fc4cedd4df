# SPDX-License-Identifier: MIT
"""Scans of a sequence of results, whose folder may have been moved or renamed since."""

import os
from dataclasses import replace
from pathlib import Path

from salsanext_cli.core.errors import NoInputError
from salsanext_cli.io.files.reading import is_folder, present
from salsanext_cli.io.formats.recordings import reachable_recording
from salsanext_cli.runs.results.manifest import ScanSource
from salsanext_cli.runs.results.query import DATASET_VARIABLE
from salsanext_cli.runs.scans.layouts import SCAN_FOLDER
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.scan_search import find_scans, scans_at_top, scans_of_sequences


def recorded_scans(source: ScanSource, sequence: str) -> list[ScanFile]:
    """Return the scans of a sequence in the folder that was recorded, none if they are gone."""
    folder = Path(source.folder)
    if not is_folder(folder) and not reachable_recording(folder):
        return []
    scans = _scans_in(folder, sequence)
    listed = {scan.path.name for scan in scans}
    # Tables beside clouds are scans only if they were named.
    for stem, suffix in source.suffixes.items():
        name = stem + suffix
        if suffix and name not in listed and present(folder / name):
            scans.append(ScanFile(sequence=sequence, stem=stem, path=folder / name))
    return scans


def scans_of_data_set(dataset: Path | None, sequence: str, *, is_recorded: bool) -> list[ScanFile]:
    """Return the scans of a sequence in the data set of the user, none if it lacks them.

    Parameters
    ----------
    dataset : Path, optional
        Data set, by default that of the variable, else the current folder.
    sequence : str
        Name of the sequence.
    is_recorded : bool
        Whether a run recorded its scans. Such scans are not looked for in the current folder:
        others of their names may be there while the recorded ones are out of reach.

    Returns
    -------
    list of ScanFile
    """
    variable = os.environ.get(DATASET_VARIABLE, "")
    if not dataset and not variable and is_recorded:
        return []
    root = dataset or Path(variable)
    scan_folder = root / "sequences" / sequence / SCAN_FOLDER
    if is_folder(scan_folder):
        return find_scans(scan_folder, unique=False)
    if is_folder(root if dataset else root / "sequences"):
        return find_scans(root, [sequence], unique=False)
    return []


def scans_beside(out: Path, sequence: str) -> list[ScanFile]:
    """Return the scans of a sequence beside its results, in one data set with them."""
    scan_folder = out / "sequences" / sequence / SCAN_FOLDER
    return find_scans(scan_folder, unique=False) if is_folder(scan_folder) else []


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
