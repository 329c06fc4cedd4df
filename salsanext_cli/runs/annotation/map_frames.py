# SPDX-License-Identifier: MIT
"""Frames of scans in a map, which their files state, or `frames.json` beside them."""

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path

from salsanext_cli.core.errors import FormatError
from salsanext_cli.core.records import Origin, Scan
from salsanext_cli.io.formats.survey.local_frame import NO_SHIFT
from salsanext_cli.io.frames import (
    FRAMES,
    HINT,
    encode_frames,
    is_ignored,
    read_frames,
    read_written_frames,
)
from salsanext_cli.runs.annotation.picked_frames import require_recorded_frames
from salsanext_cli.runs.results.owned_folder import OwnedFolder, foreign_file
from salsanext_cli.runs.scans.layouts import SCAN_FOLDER
from salsanext_cli.runs.scans.scan_file import ScanFile


def frames_beside(scans: Iterable[ScanFile]) -> dict[ScanFile, Origin]:
    """Return the frames of scans in files beside them, which `pick`, `convert` and `filter` write.

    A frame is the position of the origin of the points in map coordinates, in metres.

    Raises
    ------
    FormatError
        If a file is damaged, or lacks a frame that `pick` recorded.
    """
    listed = list(scans)
    frames = _written_frames(listed)
    for folder, stems in _stems_by_folder(listed).items():
        require_recorded_frames(folder, stems, frames[folder])
    return {
        scan: frames[scan.path.parent][scan.stem]
        for scan in listed
        if scan.stem in frames.get(scan.path.parent, {})
    }


def frame_of(file: ScanFile, scan: Scan, beside: Mapping[ScanFile, Origin]) -> Origin:
    """Return the frame of the points of a scan: that of its file, else that beside it.

    `beside`: frames by `frames_beside`. A scan around its sensor has `NO_SHIFT`.
    """
    stated = scan.notes.frame
    return stated if stated != NO_SHIFT else beside.get(file, NO_SHIFT)


def with_frame(file: ScanFile, scan: Scan, beside: Mapping[ScanFile, Origin]) -> Scan:
    """Return a scan whose notes have the frame of its points, as of `frame_of`."""
    frame = frame_of(file, scan, beside)
    return replace(scan, notes=replace(scan.notes, frame=frame))


def digest_of_frames(scans: Iterable[ScanFile]) -> str | None:
    """Return a digest of the files of frames beside scans; None without frames.

    It is of whole files, so that runs on some of the scans have the same. A file that is missing
    does not count: only the runs that need it refuse it.
    """
    by_folder = _written_frames(scans)
    frames = {folder: members for folder, members in by_folder.items() if members}
    if not frames:
        return None
    by_name = sorted((folder.parent.name, encode_frames(frames[folder])) for folder in frames)
    content = b"".join(name.encode("utf-8", "surrogateescape") + text for name, text in by_name)
    return hashlib.sha256(content).hexdigest()[:24]


def refuse_ignored_frames(scans: Iterable[ScanFile]) -> None:
    """Refuse scans whose earlier results have frames, if the file beside them is ignored now.

    Without their frames, points in map coordinates would become local ones.

    Raises
    ------
    FormatError
        If another program wrote a file with the name of frames.
    """
    for folder in _stems_by_folder(scans):
        path = folder.with_name(FRAMES)
        if is_ignored(path):
            problem = "is not a file of frames, by which earlier results are in map coordinates"
            raise FormatError(path, problem, "frames", f"{HINT}; without them, move the file away")


def refuse_lost_frames(owned: OwnedFolder, scans: Iterable[ScanFile]) -> None:
    """Refuse scans of sequences whose earlier copies have frames, as `refuse_ignored_frames` does.

    Parameters
    ----------
    owned : OwnedFolder
        Folder with the earlier copies.
    scans : iterable of ScanFile
        Scans that may take the place of the earlier ones.

    Raises
    ------
    FormatError
        If another program wrote a file with the name of frames.
    """
    by_sequence: dict[str, list[ScanFile]] = {}
    for scan in scans:
        by_sequence.setdefault(scan.sequence, []).append(scan)
    for members in by_sequence.values():
        if read_written_frames(_path(owned, members[0])):
            refuse_ignored_frames(members)


@dataclass(frozen=True, slots=True, kw_only=True)
class ChangedFrames:
    """File of the frames of copies of scans, which has to change."""

    path: Path
    frames: dict[str, Origin]  # Its new content, by stem, metres
    scans: list[ScanFile]  # Scans whose frame differs from the recorded one


def missing_frames(owned: OwnedFolder, frames: Mapping[ScanFile, Origin]) -> list[ChangedFrames]:
    """Return the files of frames that lack scans that were moved, with what they contain already.

    Written frames stay, as the copies of their scans do. A file that the user edited is refused if
    it lacks a frame.
    """
    moved = [scan for scan, frame in frames.items() if frame != NO_SHIFT]
    recorded = {path: read_written_frames(path) for path in {_path(owned, scan) for scan in moved}}
    added = [scan for scan in moved if scan.stem not in recorded[_path(owned, scan)]]
    return changed_frames(owned, added, frames)


def changed_frames(
    owned: OwnedFolder, scans: Iterable[ScanFile], frames: Mapping[ScanFile, Origin]
) -> list[ChangedFrames]:
    """Return the files of frames that have to change, since they have other frames of scans.

    Frames that the user stated for copies of scans without one stay.

    Parameters
    ----------
    owned : OwnedFolder
        Folder with copies of scans.
    scans : iterable of ScanFile
        Scans whose frames are compared; those of others stay.
    frames : mapping of ScanFile to tuple of float
        Frames of the scans that were moved, metres.

    Returns
    -------
    list of ChangedFrames

    Raises
    ------
    OutputError
        If salsanext did not write such a file, or the user edited it.
    """
    changed = []
    for path, group in groupby(sorted(scans), lambda scan: _path(owned, scan)):
        members = list(group)
        current = {scan.stem: frames.get(scan, NO_SHIFT) for scan in members}
        recorded = read_written_frames(path)
        combined = {
            stem: frame for stem, frame in (recorded | current).items() if frame != NO_SHIFT
        }
        differing = [
            scan for scan in members if current[scan.stem] != recorded.get(scan.stem, NO_SHIFT)
        ]
        if differing:
            changed.append(ChangedFrames(path=path, frames=combined, scans=differing))
    foreign = {*owned.foreign_files([change.path for change in changed])}
    for change in changed:
        has_frames = any(frames.get(scan, NO_SHIFT) != NO_SHIFT for scan in change.scans)
        if change.path in foreign and has_frames:
            raise foreign_file(change.path)
    return [change for change in changed if change.path not in foreign]


def write_frames(owned: OwnedFolder, changed: Iterable[ChangedFrames]) -> None:
    """Write changed files of frames; a file without any is removed."""
    for change in changed:
        if change.frames:
            owned.write(change.path, encode_frames(change.frames))
        else:
            owned.remove_written([change.path])


def _path(owned: OwnedFolder, scan: ScanFile) -> Path:
    """Return the file of the frames of the copies of a sequence."""
    return owned.root / "sequences" / scan.sequence / FRAMES


def _written_frames(scans: Iterable[ScanFile]) -> dict[Path, dict[str, Origin]]:
    """Return the frames in the file beside each folder of scans, by stem; none without a file."""
    return {folder: read_frames(folder.with_name(FRAMES)) for folder in _stems_by_folder(scans)}


def _stems_by_folder(scans: Iterable[ScanFile]) -> dict[Path, set[str]]:
    """Return the stems of scans in folders that may have a file of frames beside them, sorted."""
    stems: dict[Path, set[str]] = {}
    for scan in scans:
        folder = scan.path.parent
        if folder.name == SCAN_FOLDER:
            stems.setdefault(folder, set()).add(scan.stem)
    return dict(sorted(stems.items()))
