# SPDX-License-Identifier: MIT
"""Frames of picked scans, as the record of `pick` states them."""

import logging
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from salsanext_cli.core.errors import FormatError, OutputError, SalsanextError
from salsanext_cli.core.notices import warn_once
from salsanext_cli.core.records import Origin
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.texts import first_few
from salsanext_cli.io.files.json_files import read_json, record_of
from salsanext_cli.io.formats import read_scan
from salsanext_cli.io.formats.survey.local_frame import NO_SHIFT
from salsanext_cli.io.frames import FRAMES, HINT, read_written_frames
from salsanext_cli.runs.scans.layouts import PICK_RECORD
from salsanext_cli.runs.scans.scan_file import ScanFile

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class PickedFrame:
    """Frame of the points of a picked scan."""

    origin: Origin  # In map coordinates, metres
    is_beside: bool  # Whether a file beside the scan states it, not that of the scan itself


PickedFrames = dict[str, PickedFrame | None]
"""Frame of each picked scan by its name; None for a scan around its sensor.

Scans that could not be read for it have no entry."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _FramesOfRecord:
    """Frames in the record of `pick`; its other keys are not read."""

    frames: PickedFrames | None = None


def picked_frames(
    stated: Mapping[ScanFile, Origin], beside: Mapping[ScanFile, Origin]
) -> PickedFrames:
    """Return the frames of picked scans.

    Parameters
    ----------
    stated : mapping of ScanFile to tuple of float
        Frame in the file of each picked scan, metres; `NO_SHIFT` if it states none.
    beside : mapping of ScanFile to tuple of float
        Frames in files beside the scans, metres.

    Returns
    -------
    dict of str to PickedFrame or None
    """
    frames: PickedFrames = {}
    for scan, origin in sorted(stated.items()):
        is_beside = origin == NO_SHIFT
        frame = beside.get(scan, NO_SHIFT) if is_beside else origin
        has_frame = frame != NO_SHIFT
        frames[scan.name] = PickedFrame(origin=frame, is_beside=is_beside) if has_frame else None
    return frames


def frames_of_copies(
    root: Path, scans: Sequence[ScanFile], sensor: Sensor, beside: Mapping[ScanFile, Origin]
) -> PickedFrames:
    """Return the frames of scans that an earlier version picked without recording them.

    Frames in the data set are those of its points, also if the scans have others now. Scans that
    cannot be read have no entry, unless the data set has their frame.

    Parameters
    ----------
    root : Path
        Folder of the data set.
    scans : sequence of ScanFile
        The picked scans.
    sensor : Sensor
        Their sensor.
    beside : mapping of ScanFile to tuple of float
        Frames in files beside the scans, metres.

    Returns
    -------
    dict of str to PickedFrame or None
    """
    stated: dict[ScanFile, Origin] = {}
    for scan in scans:
        # A scan that cannot be read is a failure of the run.
        with suppress(SalsanextError):
            stated[scan] = read_scan(scan.path, sensor).notes.frame
    frames = picked_frames(stated, beside)
    for scan in scans:
        written = read_written_frames(root / "sequences" / scan.sequence / FRAMES)
        if scan.stem in written:
            is_beside = stated.get(scan, NO_SHIFT) == NO_SHIFT
            frames[scan.name] = PickedFrame(origin=written[scan.stem], is_beside=is_beside)
    return frames


def sequences_without_file(frames: PickedFrames) -> set[str]:
    """Return the sequences in a map that need no file beside the scans, which state all frames."""
    in_map = {name: frame for name, frame in frames.items() if frame is not None}
    beside = {_sequence(name) for name, frame in in_map.items() if frame.is_beside}
    return {_sequence(name) for name in in_map} - beside


def _sequence(name: str) -> str:
    """Return the sequence of the name of a scan."""
    return name.rpartition("/")[0]


def origins_of(frames: PickedFrames, scans: Iterable[ScanFile]) -> dict[ScanFile, Origin]:
    """Return the recorded frame of each scan in metres, `NO_SHIFT` for those without one."""
    origins = {}
    for scan in scans:
        frame = frames.get(scan.name)
        origins[scan] = frame.origin if frame else NO_SHIFT
    return origins


def require_recorded_frames(
    folder: Path, stems: Collection[str], frames: Mapping[str, Origin]
) -> None:
    """Refuse picked scans whose frames are lost: their points alone are not in the map.

    Frames that a person changed are used with a warning. Folders that `pick` did not write, or an
    earlier version of it, have no recorded frames.

    Parameters
    ----------
    folder : Path
        Folder of scans.
    stems : collection of str
        Stems of those of its scans that are read.
    frames : mapping of str to tuple of float
        Frames in the file beside the folder, metres, by stem.

    Raises
    ------
    FormatError
        If the file lacks the recorded frame of a scan.
    """
    sequence = folder.parent
    recorded = _recorded_frames(sequence.parent.parent)
    expected: dict[str, Origin] = {}
    for stem in sorted(stems):
        frame = recorded.get(f"{sequence.name}/{stem}")
        if frame is not None:
            expected[stem] = frame.origin
    path = folder.with_name(FRAMES)
    missing = [stem for stem in expected if stem not in frames]
    if missing:
        problem = f"has no frame of {first_few(missing)}, which `pick` moved out of a map"
        hint = f"run `pick` again with the same settings, or copy them from {PICK_RECORD}: {HINT}"
        raise FormatError(path, problem, "the frames of all picked scans", hint)
    changed = [stem for stem in expected if frames[stem] != expected[stem]]
    if changed:
        text = f"{path}: frames of {first_few(changed)} differ from those in {PICK_RECORD}"
        warn_once(log, text)


def _recorded_frames(root: Path) -> PickedFrames:
    """Return the frames in the record of `pick` in a folder, if there is one."""
    path = root / PICK_RECORD
    try:
        data = read_json(path)
    except OutputError:
        return {}  # Another program wrote the file.
    if data is None or data.get("stage") != path.stem:
        return {}
    return record_of(_FramesOfRecord, data, path).frames or {}
