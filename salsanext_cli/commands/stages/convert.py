# SPDX-License-Identifier: MIT
"""Stage `convert`: a recording to a folder of scans in the layout of SemanticKITTI."""

import logging
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from salsanext_cli.core.errors import OutputError, UsageError
from salsanext_cli.core.poses import POSES
from salsanext_cli.core.texts import counted, first_few, shortened
from salsanext_cli.core.wording import argument
from salsanext_cli.io.files.reading import filled
from salsanext_cli.io.formats import read_scan
from salsanext_cli.io.formats.kitti import encode_bin
from salsanext_cli.io.formats.recordings import is_site, recorded_poses, recording_of
from salsanext_cli.io.poses import encode_poses
from salsanext_cli.runs.loop.run import Outcome, RunOptions, run_over_scans
from salsanext_cli.runs.results.layouts import SCAN_FOLDER
from salsanext_cli.runs.results.manifest import StageRecord
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.runs.results.paths import ScanFile, find_scans, require_no_hidden_scans

TIMES = "times.txt"
EXPECTED = "a ROS bag, a recording of Ouster or Velodyne, or an E57 file"

log = logging.getLogger(__name__)


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
    E57 file have numbers instead of times, and `poses.txt`.

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
    times = folder / sequence / TIMES
    poses = folder / sequence / POSES
    require_no_hidden_scans(folder)
    with owned.open():
        owned.refuse_foreign([*_visible_files(scan_folder), times, poses])
        owned.manifest.write(_source_of(listed[0], owned))
        empty: set[str] = set()
        task = partial(_convert_scan, owned=owned, scan_folder=scan_folder)

        def is_done(scan: ScanFile) -> bool:
            return filled(_target(scan_folder, scan))

        outcome = run_over_scans(
            task, chosen, options, is_done=is_done, on_result=empty.update, folder=folder
        )
        written = [scan for scan in listed if is_done(scan)]
        if not is_site(file):
            owned.write(times, _encoded_times(written))
        elif (poses_of_site := recorded_poses(file)) is not None:
            numbers = [int(scan.stem) for scan in written]
            owned.write(poses, encode_poses(poses_of_site[numbers]))
    if empty:
        names = first_few(sorted(empty))
        log.warning("%s without points skipped: %s", counted(len(empty), "scan"), names)
    return replace(outcome, done=outcome.done - len(empty))


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


def _convert_scan(scan: ScanFile, owned: OwnedFolder, scan_folder: Path) -> tuple[str, ...]:
    """Write a scan; return its name if it has no points."""
    points = read_scan(scan.path)
    if not len(points):
        return (scan.stem,)
    owned.write(_target(scan_folder, scan), encode_bin(points))
    return ()


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
