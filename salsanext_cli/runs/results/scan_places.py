# SPDX-License-Identifier: MIT
"""Where scans with results are, compared with where they were recorded."""

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum, auto
from pathlib import Path

from salsanext_cli.io.files.reading import is_folder, is_same_file, present
from salsanext_cli.io.formats.recordings import recording_of
from salsanext_cli.runs.results.manifest import Manifest
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.selection import data_set_of

MAX_DEPTH_OF_DRIVES = 2
"""Levels from the folder of all drives to the scans of one: `DRIVE/velodyne`."""


class PlaceState(Enum):
    """Places of scans; of several scans, the last state that one of them has."""

    RECORDED = auto()  # Where it was recorded
    LINKED = auto()  # At another path, which leads to the recorded file
    MOVED = auto()  # Elsewhere, while the recorded file is gone
    OTHER = auto()  # Elsewhere, while the recorded file is still there: maybe of another data set


@dataclass(frozen=True, slots=True, kw_only=True)
class MovedFolder:
    """Folder of scans that was moved since results were computed."""

    before: Path
    now: Path


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanPlaces:
    """Places of scans with results."""

    state: PlaceState
    # By sequence, if the state is `MOVED`
    moved: Mapping[str, MovedFolder] = field(default_factory=dict)

    @property
    def are_recorded(self) -> bool:
        """Whether every scan is where it was recorded."""
        return self.state is PlaceState.RECORDED

    @property
    def is_to_record(self) -> bool:
        """Whether a run records the places, which refuses scans that may be others.

        The recorded paths of other scans stay.
        """
        return self.state in (PlaceState.RECORDED, PlaceState.OTHER)

    @property
    def moved_to(self) -> dict[str, str]:
        """Present folder of moved scans by sequence."""
        return {sequence: str(folder.now) for sequence, folder in self.moved.items()}


def scan_places(out: Path, scans: Iterable[ScanFile]) -> ScanPlaces:
    """Compare the places of scans with those that the runs in a folder recorded.

    Parameters
    ----------
    out : Path
        Folder with results.
    scans : iterable of ScanFile
        Scans where they are now. Those that no run recorded are where they belong.

    Returns
    -------
    ScanPlaces
    """
    sources = Manifest(out).sources()
    moved: dict[str, MovedFolder] = {}
    is_linked = False
    for scan in scans:
        source = sources.get(scan.sequence)
        recorded = source.path(scan) if source else scan.path
        state = _state(recorded, scan.path)
        if state is PlaceState.OTHER:
            return ScanPlaces(state=state)
        if state is PlaceState.MOVED:
            folder = MovedFolder(before=recorded.parent, now=scan.path.parent)
            moved.setdefault(scan.sequence, folder)
        is_linked = is_linked or state is PlaceState.LINKED
    if moved:
        return ScanPlaces(state=PlaceState.MOVED, moved=moved)
    return ScanPlaces(state=PlaceState.LINKED if is_linked else PlaceState.RECORDED)


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


def moved_data_set(out: Path, scans: Iterable[ScanFile]) -> Path | None:
    """Return the data set of all recorded scans after a move; None if some are not in it.

    Parameters
    ----------
    out : Path
        Folder with results.
    scans : iterable of ScanFile
        Scans where they are now, at least one of which was moved.

    Returns
    -------
    Path or None
        Root of the data set of the first moved scan, else the common folder of all drives, since a
        stage on the results of all drives finds none of them in the folder of another.
    """
    moved_scans = [scan for scan in scans if not scan_places(out, [scan]).are_recorded]
    folders = [Path(folder) for folder in folders_now(Manifest(out), moved_scans).values()]
    if not all(is_folder(folder) or recording_of(folder) for folder in folders):
        return None
    data_set = data_set_of(moved_scans[0])
    if data_set is not None:
        return data_set if all(folder.is_relative_to(data_set) for folder in folders) else None
    common = Path(os.path.commonpath(folders))
    depth = max(len(folder.relative_to(common).parts) for folder in folders)
    return common if depth <= MAX_DEPTH_OF_DRIVES else None


def _state(recorded: Path, now: Path) -> PlaceState:
    """Return the state of one scan."""
    if recorded == now:
        return PlaceState.RECORDED
    if _are_same(recorded, now):
        return PlaceState.LINKED
    is_there = present(recorded) or recording_of(recorded) is not None
    if is_there or recorded.name != now.name:
        return PlaceState.OTHER
    return PlaceState.MOVED


def _are_same(first: Path, second: Path) -> bool:
    """Return whether two paths lead to the same file, or to the same scan of one recording."""
    recording = recording_of(first)
    other = recording_of(second)
    if recording is None or other is None:
        return is_same_file(first, second)
    has_same_name = first.relative_to(recording) == second.relative_to(other)
    return has_same_name and is_same_file(recording, other)
