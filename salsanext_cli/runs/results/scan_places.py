# SPDX-License-Identifier: MIT
"""Where scans with results are, compared with where they were recorded."""

import os
from collections.abc import Iterable, Sequence
from enum import Enum, auto
from pathlib import Path

from salsanext_cli.io.files.reading import is_folder, is_same_file, reachable
from salsanext_cli.io.formats.recordings import reachable_recording
from salsanext_cli.runs.results.manifest import Manifest
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.selection import data_set_of

MAX_DEPTH_OF_DRIVES = 2
"""Levels from the folder of all drives to the scans of one: `DRIVE/velodyne`."""


class PlaceState(Enum):
    """Places of scans. Several scans have the state of one of them that is last in this list."""

    RECORDED = auto()  # Where they were recorded
    LINKED = auto()  # At other paths, which lead to the recorded files
    MOVED = auto()  # Elsewhere, while the recorded files are gone or cannot be reached
    OTHER = auto()  # Elsewhere, while a recorded file is still there: maybe of another data set


def place_state(out: Path, scans: Iterable[ScanFile]) -> PlaceState:
    """Compare the places of scans with those that the runs in a folder recorded.

    Parameters
    ----------
    out : Path
        Folder with results.
    scans : iterable of ScanFile
        Scans where they are now. Those that no run recorded are where they belong.

    Returns
    -------
    PlaceState
    """
    records = RecordedPlaces(out)
    states = {PlaceState.RECORDED}
    for scan in scans:
        state = records.state(records.recorded_place(scan), scan.path)
        if state is PlaceState.OTHER:
            return state
        states.add(state)
    return max(states, key=lambda state: state.value)


def folders_now(records: Manifest, scans: Iterable[ScanFile]) -> dict[str, str]:
    """Return where each recorded folder is, if all moved together with that of a scan."""
    by_sequence: dict[str, str] = {}
    for record in records.records().values():
        by_sequence.update({name: source.folder for name, source in record.scans.items()})
    scan = next((scan for scan in scans if scan.sequence in by_sequence), None)
    if scan is None:
        return {}
    now = scan.path.parent
    before = by_sequence[scan.sequence]
    return {
        folder: os.path.normpath(now / os.path.relpath(folder, before))
        for folder in by_sequence.values()
    }


def moved_data_set(out: Path, scans: Sequence[ScanFile]) -> Path | None:
    """Return the data set of all recorded scans after a move; None if some are not in it.

    Parameters
    ----------
    out : Path
        Folder with results.
    scans : sequence of ScanFile
        Scans where they are now, at least one of which was moved.

    Returns
    -------
    Path or None
        Root of the data set of the first moved scan, else the common folder of all drives, since a
        stage on the results of all drives finds none of them in the folder of another.
    """
    records = RecordedPlaces(out)
    moved_scan = next(scan for scan in scans if records.recorded_place(scan) != scan.path)
    folders = [Path(folder) for folder in folders_now(Manifest(out), [moved_scan]).values()]
    if not all(is_folder(folder) or reachable_recording(folder) for folder in folders):
        return None
    data_set = data_set_of(moved_scan)
    if data_set is not None:
        return data_set if all(folder.is_relative_to(data_set) for folder in folders) else None
    common = Path(os.path.commonpath(folders))
    depth = max(len(folder.relative_to(common).parts) for folder in folders)
    return common if depth <= MAX_DEPTH_OF_DRIVES else None


class RecordedPlaces:
    """Places of scans in the records of a folder; each folder is asked for a recording once."""

    def __init__(self, out: Path) -> None:
        self._sources = Manifest(out).sources()
        self._recordings: dict[Path, Path | None] = {}

    def recorded_place(self, scan: ScanFile) -> Path:
        """Return where a scan was recorded; its own path if it was not."""
        source = self._sources.get(scan.sequence)
        return source.path(scan) if source else scan.path

    def state(self, recorded: Path, now: Path) -> PlaceState:
        """Return the state of one scan."""
        if recorded == now:
            return PlaceState.RECORDED
        if self._are_same(recorded, now):
            return PlaceState.LINKED
        is_there = reachable(recorded) or self._recording(recorded) is not None
        if is_there or recorded.name != now.name:
            return PlaceState.OTHER
        return PlaceState.MOVED

    def _are_same(self, first: Path, second: Path) -> bool:
        """Return whether two paths lead to the same file, or to the same scan of a recording."""
        if reachable(first) and reachable(second):
            return is_same_file(first, second)
        recording = self._recording(first)
        other = self._recording(second)
        if recording is None or other is None:
            return False
        has_same_name = first.relative_to(recording) == second.relative_to(other)
        return has_same_name and is_same_file(recording, other)

    def _recording(self, scan: Path) -> Path | None:
        """Return the recording that a scan is in, None for other scans."""
        folder = scan.parent
        if folder not in self._recordings:
            self._recordings[folder] = reachable_recording(folder)
        return self._recordings[folder]
