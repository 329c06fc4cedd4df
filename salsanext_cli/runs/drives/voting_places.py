# SPDX-License-Identifier: MIT
"""Where scans that vote are, compared with where earlier votes were computed."""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from salsanext_cli.runs.results.folder_names import DISAGREEMENT
from salsanext_cli.runs.results.manifest import Manifest
from salsanext_cli.runs.results.output_paths import find_outputs
from salsanext_cli.runs.results.scan_places import PlaceState, RecordedPlaces
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.selection import data_set_of

AT_PLACE = (PlaceState.RECORDED, PlaceState.LINKED)
"""States of a scan that is at a place itself, or at a link to it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MovedFolder:
    """Data set, or folder of scans, that was moved since results were computed."""

    before: Path
    now: Path


@dataclass(frozen=True, slots=True, kw_only=True)
class OtherScan:
    """Scan that may be another one than that of earlier results, which is still there."""

    before: Path
    scan: ScanFile
    has_voted: bool  # Whether votes were computed with the earlier one after a move


@dataclass(slots=True, kw_only=True)
class VotingPlaces:
    """Places of scans that vote."""

    are_recorded: bool = True  # Whether every scan is where it was recorded
    moves: list[MovedFolder] = field(default_factory=list)
    # Folder by sequence of the moved scans of the votes that a run writes, for its record
    moved: dict[str, str] = field(default_factory=dict)
    other: OtherScan | None = None  # The first one


def voting_places(
    folder: Path, voting: Iterable[ScanFile], written: Collection[ScanFile], *, overwrite: bool
) -> VotingPlaces:
    """Compare the places of scans that vote with those of the results in a folder.

    A scan at the place where earlier votes of its sequence were computed is the right one, also
    while another scan is where it was first recorded.

    Parameters
    ----------
    folder : Path
        Folder with results.
    voting : iterable of ScanFile
        Scans that vote, where they are now.
    written : collection of ScanFile
        Scans whose votes the run writes.
    overwrite : bool
        Whether these replace earlier votes, whose places then do not matter.

    Returns
    -------
    VotingPlaces
    """
    records = RecordedPlaces(folder)
    record = Manifest(folder).record("fuse")
    moved_before = record.moved if record else {}
    with_votes = _sequences_with_votes(folder, written if overwrite else ())
    folders_of_votes = {name: place for name, place in moved_before.items() if name in with_votes}
    to_write = {scan.sequence for scan in written}
    places = VotingPlaces()
    sequences: set[str] = set()
    first_moved: dict[str, ScanFile] = {}
    places_before: dict[str, Path] = {}
    for scan in voting:
        name = scan.sequence
        sequences.add(name)
        recorded = records.recorded_place(scan)
        state = records.state(recorded, scan.path)
        voting_place = recorded
        state_of_votes = state
        if name in folders_of_votes:
            voting_place = Path(folders_of_votes[name], recorded.name)
            state_of_votes = records.state(voting_place, scan.path)
        states = (state, state_of_votes)
        if PlaceState.OTHER in states and state_of_votes not in AT_PLACE:
            has_voted = state is not PlaceState.OTHER
            before = voting_place if has_voted else recorded
            places.other = OtherScan(before=before, scan=scan, has_voted=has_voted)
            return places
        if PlaceState.MOVED in states and name not in first_moved:
            first_moved[name] = scan
            places_before[name] = recorded if state is PlaceState.MOVED else voting_place
        places.are_recorded = places.are_recorded and recorded == scan.path
        is_new_place = name in moved_before or state not in AT_PLACE
        if name in to_write and name not in with_votes and is_new_place:
            places.moved[name] = str(scan.path.parent)
    places.moves = _moves(first_moved, places_before, is_every=len(first_moved) == len(sequences))
    return places


def _sequences_with_votes(folder: Path, replaced: Iterable[ScanFile]) -> set[str]:
    """Return the sequences with votes in a folder that are not of replaced scans."""
    names = {(scan.sequence, scan.stem) for scan in replaced}
    return {name[0] for name in find_outputs(folder, DISAGREEMENT) if name not in names}


def _moves(
    scans: Mapping[str, ScanFile], places_before: Mapping[str, Path], *, is_every: bool
) -> list[MovedFolder]:
    """Return the moved data set if all sequences were moved with it, else their folders.

    Parameters
    ----------
    scans : mapping of str to ScanFile
        A moved scan of each moved sequence.
    places_before : mapping of str to Path
        Where it was before, by sequence.
    is_every : bool
        Whether all sequences were moved.

    Returns
    -------
    list of MovedFolder
    """
    roots: set[MovedFolder | None] = set()
    folders: list[MovedFolder] = []
    for name, scan in scans.items():
        place = places_before[name]
        roots.add(_moved_data_set(place, scan))
        folders.append(MovedFolder(before=place.parent, now=scan.path.parent))
    root = roots.pop() if is_every and len(roots) == 1 else None
    return [root] if root else folders


def _moved_data_set(place: Path, scan: ScanFile) -> MovedFolder | None:
    """Return the move of the data set of a scan from a place; None if its name in it changed."""
    now = data_set_of(scan)
    if now is None:
        return None
    # The place cannot be asked for its data set, since it may be out of reach.
    names = scan.path.relative_to(now).parts
    if place.parts[-len(names) :] != names:
        return None
    return MovedFolder(before=place.parents[len(names) - 1], now=now)
