# SPDX-License-Identifier: MIT
"""Stage `convert`: a recording to a folder of scans in the layout of SemanticKITTI."""

import logging
from dataclasses import replace
from functools import partial
from pathlib import Path

from salsanext_cli.core.errors import OutputError, UsageError
from salsanext_cli.core.texts import counted, first_few, shortened
from salsanext_cli.core.wording import argument
from salsanext_cli.io.files.reading import filled
from salsanext_cli.io.formats import read_scan
from salsanext_cli.io.formats.kitti import encode_bin
from salsanext_cli.io.formats.recordings import recording_of
from salsanext_cli.runs.loop.run import Outcome, RunOptions, run_over_scans
from salsanext_cli.runs.results.layouts import SCAN_FOLDER
from salsanext_cli.runs.results.manifest import StageRecord
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.runs.results.paths import ScanFile, find_scans, require_none_hidden

TIMES = "times.txt"

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

    Times are seconds since the first scan. Intensities of one byte are divided by 255.

    Parameters
    ----------
    recording, folder : Path
        ROS bag, recording of Ouster or Velodyne, or topic of one, and folder of the data set.
    every, limit : int
        Step between converted scans, and their largest number, by default all.
    options : RunOptions
        Workers and shards.

    Returns
    -------
    Outcome
    """
    for name, value in {"every": every, "limit": 1 if limit is None else limit}.items():
        if value < 1:
            raise UsageError(argument(name), f"is {value}", "at least 1")
    if recording_of(recording.absolute()) is None:
        problem = "is not a recording" if recording.exists() else "no such recording"
        raise UsageError(recording, problem, "a ROS bag, or a recording of Ouster or Velodyne")
    listed = find_scans(recording)
    chosen = listed[::every][:limit]
    sequence = Path("sequences", listed[0].sequence)
    owned, place = OwnedFolder(folder, "convert", str(sequence)), folder / sequence / SCAN_FOLDER
    require_none_hidden(folder)
    with owned.open():
        before = sorted(place.iterdir()) if place.is_dir() else []
        scans = [path for path in before if not path.name.startswith(".")]
        owned.refuse_foreign([*scans, place.parent / TIMES])
        owned.manifest.write(_source_of(listed[0], owned))
        empty: set[str] = set()
        task = partial(_convert_scan, owned=owned, place=place)

        def is_done(scan: ScanFile) -> bool:
            return filled(_target(place, scan))

        outcome = run_over_scans(task, chosen, options, is_done=is_done, on_result=empty.update)
        # The name of a scan is its time in nanoseconds.
        stems = [scan.stem for scan in listed if filled(_target(place, scan))]
        times = [int(stem.partition("_")[0]) for stem in stems]
        lines = [f"{(time - times[0]) / 1e9:.9f}\n" for time in times]
        owned.write(folder / sequence / TIMES, "".join(lines).encode())
    if empty:
        names = first_few(sorted(empty))
        log.warning("%s without points skipped: %s", counted(len(empty), "scan"), names)
    return replace(outcome, done=outcome.done - len(empty))


def _target(place: Path, scan: ScanFile) -> Path:
    return place / f"{scan.stem}.bin"


def _convert_scan(scan: ScanFile, owned: OwnedFolder, place: Path) -> tuple[str, ...]:
    """Write a scan; return its name if it has no points."""
    points = read_scan(scan.path)
    if not len(points):
        return (scan.stem,)
    owned.write(_target(place, scan), encode_bin(points))
    return ()


def _source_of(first: ScanFile, owned: OwnedFolder) -> StageRecord:
    """Return the record of the source of scans; refuse a folder with scans of another source."""
    recording = recording_of(first.path) or first.path
    topic = str(first.path.parent.relative_to(recording))
    wanted = {"recording": recording.name, "topic": topic, "first": first.stem}
    recorded = owned.manifest.record(owned.stage)
    if recorded and recorded.settings != wanted:
        of_topic = (shortened(recorded.settings.get(key)) for key in ("recording", "topic"))
        problem, expected = f"has scans of {', '.join(of_topic)}", f"{recording.name}, {topic}"
        raise OutputError(owned.record_path.parent, problem, expected, "choose another folder")
    return recorded or StageRecord(stage=owned.stage, settings=wanted)
