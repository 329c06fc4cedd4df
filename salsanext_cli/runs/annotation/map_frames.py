# SPDX-License-Identifier: MIT
"""Frames of scans in a map, which their files state, or `frames.json` beside them."""

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

from salsanext_cli.core.records import Origin, Scan
from salsanext_cli.io.files.reading import present
from salsanext_cli.io.formats.survey.local_frame import NO_SHIFT
from salsanext_cli.io.frames import FRAMES, encode_frames, read_frames
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.runs.scans.layouts import SCAN_FOLDER
from salsanext_cli.runs.scans.scan_file import ScanFile


def frames_beside(scans: Iterable[ScanFile]) -> dict[ScanFile, Origin]:
    """Return the frames of scans in files beside them, which `pick`, `convert` and `filter` write.

    A frame is the position of the origin of the points in map coordinates, in metres.
    """
    listed = list(scans)
    frames = _frames_by_folder(listed)
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
    """Return a digest of the files of frames beside scans; None without such files.

    It is of whole files, so that runs on some of the scans have the same.
    """
    frames = _frames_by_folder(scans)
    if not frames:
        return None
    by_name = sorted((folder.parent.name, encode_frames(frames[folder])) for folder in frames)
    content = b"".join(name.encode("utf-8", "surrogateescape") + text for name, text in by_name)
    return hashlib.sha256(content).hexdigest()[:24]


def add_frames(
    owned: OwnedFolder, frames: Mapping[ScanFile, Origin], rewritten: Iterable[ScanFile] = ()
) -> None:
    """Write the frames of scans that were moved, beside those that are written already.

    `rewritten`: scans whose files are written again, so that their earlier frames do not stay.
    """
    moved: dict[str, dict[str, Origin]] = {}
    for scan, frame in sorted(frames.items()):
        if frame != NO_SHIFT:
            moved.setdefault(scan.sequence, {})[scan.stem] = frame
    outdated = {(scan.sequence, scan.stem) for scan in rewritten}
    for name in sorted({*moved, *(sequence for sequence, _ in outdated)}):
        path = owned.root / "sequences" / name / FRAMES
        recorded = read_frames(path)
        stays = {stem: recorded[stem] for stem in recorded if (name, stem) not in outdated}
        combined = moved.get(name, {}) | stays
        if not combined:
            owned.remove_written([path])
        elif combined != recorded:
            owned.write(path, encode_frames(combined))


def _frames_by_folder(scans: Iterable[ScanFile]) -> dict[Path, dict[str, Origin]]:
    """Return the frames in the file of each folder of scans that has one, by stem."""
    folders = {scan.path.parent for scan in scans if scan.path.parent.name == SCAN_FOLDER}
    paths = {folder: folder.with_name(FRAMES) for folder in folders}
    return {folder: read_frames(path) for folder, path in paths.items() if present(path)}
