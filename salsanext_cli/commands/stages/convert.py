# SPDX-License-Identifier: MIT
"""Stage `convert`: a recording to a folder of scans in the layout of SemanticKITTI."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from salsanext_cli.core.errors import OutputError, UsageError
from salsanext_cli.core.poses import POSES
from salsanext_cli.core.records import Origin
from salsanext_cli.core.texts import counted, first_few, shortened
from salsanext_cli.core.wording import argument
from salsanext_cli.io.files.reading import filled
from salsanext_cli.io.formats import read_scan
from salsanext_cli.io.formats.kitti import encode_bin
from salsanext_cli.io.formats.recording_kinds import RECORDING_KINDS, kind_of
from salsanext_cli.io.formats.recordings import recorded_poses, recording_of
from salsanext_cli.io.formats.survey.local_frame import NO_SHIFT
from salsanext_cli.io.frames import FRAMES, encode_frames, read_written_frames
from salsanext_cli.io.poses import encode_poses
from salsanext_cli.runs.loop.run import Outcome, RunOptions, run_over_scans
from salsanext_cli.runs.results.manifest import StageRecord
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.runs.scans.layouts import SCAN_FOLDER
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.scan_search import find_scans, require_no_hidden_scans

TIMES = "times.txt"
NOUNS = [kind.noun for kind in RECORDING_KINDS]
EXPECTED = f"{', '.join(NOUNS[:-1])}, or {NOUNS[-1]}"

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class ConvertedScan:
    """Scan of a recording that was read."""

    stem: str
    is_empty: bool  # Scans without points are skipped
    frame: Origin  # Of its points in the coordinates of the recording, metres


def convert(
    recording: Path,
    folder: Path,
    *,
    every: int = 1,
    limit: int | None = None,
    options: RunOptions = RunOptions(),
) -> Outcome:
    """Write `FOLDER/sequences/NAME/velodyne/<time>.bin` of scans with points, and `times.txt`.

    Times are seconds since the first scan. Intensities of one byte are divided by 255. Scans of an
    E57 file have numbers instead of times, and `poses.txt`. Scans in map coordinates are moved into
    a local frame, which `frames.json` states.

    Parameters
    ----------
    recording : Path
        ROS bag, recording of Ouster or Velodyne, or topic of one; or E57 file.
    folder : Path
        Folder of the data set.
    every : int
        Step between converted scans.
    limit : int, optional
        Largest number of converted scans; by default all.
    options : RunOptions
        Workers and shards.

    Returns
    -------
    Outcome
    """
    _require_positive("every", every)
    if limit is not None:
        _require_positive("limit", limit)
    file = recording_of(recording.absolute())
    if file is None:
        problem = "is not a recording" if recording.exists() else "no such recording"
        raise UsageError(recording, problem, EXPECTED)
    listed = find_scans(recording)
    chosen = listed[::every][:limit]
    sequence = Path("sequences", listed[0].sequence)
    owned = OwnedFolder(folder, "convert", str(sequence))
    scan_folder = folder / sequence / SCAN_FOLDER
    others = [folder / sequence / name for name in (TIMES, POSES, FRAMES)]
    require_no_hidden_scans(folder)
    with owned.open():
        owned.refuse_foreign([*_visible_files(scan_folder), *others])
        owned.manifest.write(_source_of(listed[0], owned))
        converted: list[ConvertedScan] = []
        task = partial(_convert_scan, owned=owned, scan_folder=scan_folder)

        def is_done(scan: ScanFile) -> bool:
            return filled(_target(scan_folder, scan))

        outcome = run_over_scans(
            task, chosen, options, is_done=is_done, on_result=converted.append, writes=[folder]
        )
        # For a minute, a network file system may hide files that other machines have just written.
        with_points = {scan.stem for scan in converted if not scan.is_empty}
        written = {
            number: scan
            for number, scan in enumerate(listed)
            if scan.stem in with_points or is_done(scan)
        }
        _write_files_of_sequence(owned, folder / sequence, file, written)
        if kind_of(file).may_be_map:
            _add_frames(owned, folder / sequence / FRAMES, converted, [*written.values()])
    empty = [scan.stem for scan in converted if scan.is_empty]
    if empty:
        names = first_few(sorted(empty))
        log.warning("%s without points skipped: %s", counted(len(empty), "scan"), names)
    return replace(outcome, done=outcome.done - len(empty))


def _write_files_of_sequence(
    owned: OwnedFolder, folder: Path, recording: Path, written: Mapping[int, ScanFile]
) -> None:
    """Write times and poses, if the recording has them, of the written scans by their numbers."""
    if kind_of(recording).has_times:
        owned.write(folder / TIMES, _encoded_times([*written.values()]))
    poses = recorded_poses(recording)
    if poses is not None:
        owned.write(folder / POSES, encode_poses(poses[[*written]]))


def _add_frames(
    owned: OwnedFolder, path: Path, converted: Sequence[ConvertedScan], written: Sequence[ScanFile]
) -> None:
    """Write the frames of all written scans that were moved, beside those of earlier runs.

    A run that was interrupted wrote scans without their frames, which are read again.
    """
    recorded = read_written_frames(path)
    frames = {scan.stem: scan.frame for scan in converted}
    for scan in written:
        if scan.stem not in frames and scan.stem not in recorded:
            frames[scan.stem] = read_scan(scan.path).notes.frame
    moved = {stem: frame for stem, frame in frames.items() if frame != NO_SHIFT}
    if moved:
        owned.write(path, encode_frames(recorded | moved))


def _require_positive(name: str, value: int) -> None:
    if value < 1:
        raise UsageError(argument(name), f"is {value}", "at least 1")


def _visible_files(folder: Path) -> list[Path]:
    """Return the files of a folder whose names do not begin with a dot; none without a folder."""
    if not folder.is_dir():
        return []
    return [path for path in sorted(folder.iterdir()) if not path.name.startswith(".")]


def _encoded_times(scans: Sequence[ScanFile]) -> bytes:
    """Return lines with the time of each scan, in seconds since the first one."""
    # The name of a scan is its time in nanoseconds.
    times = [int(scan.stem.partition("_")[0]) for scan in scans]
    lines = [f"{(time - times[0]) / 1e9:.9f}\n" for time in times]
    return "".join(lines).encode()


def _target(scan_folder: Path, scan: ScanFile) -> Path:
    return scan_folder / f"{scan.stem}.bin"


def _convert_scan(scan: ScanFile, owned: OwnedFolder, scan_folder: Path) -> ConvertedScan:
    """Write a scan with points."""
    points = read_scan(scan.path)
    is_empty = not len(points)
    if not is_empty:
        owned.write(_target(scan_folder, scan), encode_bin(points))
    return ConvertedScan(stem=scan.stem, is_empty=is_empty, frame=points.notes.frame)


def _source_of(first: ScanFile, owned: OwnedFolder) -> StageRecord:
    """Return the record of the source of scans; refuse a folder with scans of another source."""
    recording = recording_of(first.path) or first.path
    topic = str(first.path.parent.relative_to(recording))
    settings = {"recording": recording.name, "topic": topic, "first": first.stem}
    recorded = owned.manifest.record(owned.stage)
    if recorded and recorded.settings != settings:
        recorded_recording = shortened(recorded.settings.get("recording"))
        recorded_topic = shortened(recorded.settings.get("topic"))
        problem = f"has scans of {recorded_recording}, {recorded_topic}"
        expected = f"{recording.name}, {topic}"
        raise OutputError(owned.record_path.parent, problem, expected, "choose another folder")
    return recorded or StageRecord(stage=owned.stage, settings=settings)
