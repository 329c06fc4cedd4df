# SPDX-License-Identifier: MIT
"""Recordings of many scans, read scan by scan: ROS bags and the packets of Ouster sensors.

A scan of a recording is named as if the recording were a folder, of which the topics are folders
and the scans files: ``drive.bag/velodyne_points/1612345678000000000``.
"""

import os
import re
from functools import lru_cache
from pathlib import Path

from salsanext_cli.errors import FormatError, NoInputError, UsageError, shortened
from salsanext_cli.files.reading import is_folder, present
from salsanext_cli.formats import BAG_SUFFIXES, RECORDING_SUFFIXES
from salsanext_cli.formats.bags import Bag
from salsanext_cli.formats.columns import Columns
from salsanext_cli.formats.ouster import OusterRecording

METADATA = "metadata.yaml"  # File that makes a folder with `.db3` or `.mcap` files a ROS 2 bag
NAME = re.compile(r"(-?\d{1,20})(?:_(\d{1,9}))?", re.ASCII)
MAX_SHOWN = 500  # Characters of a list of topics in an error


def is_recording(path: Path) -> bool:
    """Say whether a path is that of a recording: a file with its suffix, or a ROS 2 bag."""
    if is_folder(path):
        return present(path / METADATA) and bool(storages(path))
    return path.suffix.lower() in RECORDING_SUFFIXES and present(path)


def is_bag(recording: Path) -> bool:
    """Say whether a recording is a ROS bag."""
    return is_folder(recording) or recording.suffix.lower() in BAG_SUFFIXES


def storages(folder: Path) -> list[Path]:
    """Return the files that hold the messages of a ROS 2 bag, compressed ones included."""
    names = (path for path in folder.iterdir() if not path.name.startswith("."))
    return sorted(path for path in names if {".mcap", ".db3"} & {*path.suffixes})


def files_of(recording: Path) -> list[Path]:
    """Return the files of a recording."""
    return [recording / METADATA, *storages(recording)] if is_folder(recording) else [recording]


def recording_of(path: Path) -> Path | None:
    """Return the recording that a path is of or leads into, None for any other path."""
    existing = next((each for each in (path, *path.parents) if present(each)), None)
    return existing if existing is not None and is_recording(existing) else None


def sequence_of(recording: Path) -> str:
    """Return the name of the sequence that the scans of a recording are."""
    return recording.name if is_folder(recording) else recording.stem


Recording = Bag | OusterRecording


def recorded_paths(path: Path) -> list[Path]:
    """Return the paths of the scans of a recording, a topic in it or a scan, sorted by time."""
    folder, recording, clouds = _opened(path)
    inside = "/".join(path.relative_to(folder).parts) or _only_topic(folder, recording, clouds)
    topic, name = (inside, "") if inside in clouds else inside.rpartition("/")[::2]
    if topic not in clouds:
        listed = shortened(", ".join(clouds.values()), MAX_SHOWN)
        raise NoInputError(folder, f"no clouds of topic {inside}", f"one of {listed}")
    names = _names(recording.times(clouds[topic]))
    if name and name not in names:
        raise NoInputError(path, "no such scan", f"one of the {len(names)} of the recording")
    return [folder / topic / each for each in names if name in ("", each)]


def _only_topic(folder: Path, recording: Recording, clouds: dict[str, str]) -> str:
    """Return the topic of a recording that has one of point clouds."""
    if len(clouds) == 1:
        return next(iter(clouds))
    if clouds:
        topics = [*clouds.values()]
        found = f"{len(topics)} topics of point clouds: {shortened(', '.join(topics), MAX_SHOWN)}"
        raise UsageError(folder, found, "one of them", f"--topic {topics[0]}")
    others = ", ".join(f"{topic} ({kind})" for topic, kind in recording.topics().items())
    if isinstance(recording, OusterRecording):
        raise NoInputError(folder, "the file has no LiDAR packets", "packets with distances")
    found = f"no point clouds, but {shortened(others, MAX_SHOWN)}" if others else "no messages"
    raise NoInputError(folder, found, "clouds, such as sensor_msgs/PointCloud2")


def _names(times: list[int]) -> list[str]:
    """Return the names of scans by their times in nanoseconds; an equal one gets a suffix."""
    names: list[str] = []
    seen: dict[int, int] = {}
    for time in times:
        number = seen[time] = seen.get(time, -1) + 1
        names.append(f"{time:019d}" + (f"_{number}" if number else ""))
    return names


def recorded_columns(path: Path, _: tuple[str, ...] = ()) -> Columns:
    """Read a scan of a recording, whose path is one of the `recorded_paths`."""
    folder, recording, clouds = _opened(path)
    topic = "/".join(path.parent.relative_to(folder).parts)
    match = NAME.fullmatch(path.name)
    if topic not in clouds or match is None:
        raise FormatError(path, "not there", "a scan that the recording lists")
    return recording.columns(clouds[topic], int(match[1]), int(match[2] or 0), path)


def _opened(path: Path) -> tuple[Path, Recording, dict[str, str]]:
    """Return path and recording that a path is of, kept open, and its topics by their folders."""
    folder = recording_of(path)
    if folder is None:
        raise FormatError(path, "no such recording", "a recording or a scan in one")
    # A file that is open in a forked process has one position in both.
    version = [os.getpid()]
    for file in files_of(folder):
        status = file.stat()
        version += [status.st_ino, status.st_size, status.st_mtime_ns]
    recording = _kept(folder, tuple(version))
    return folder, recording, {topic.strip("/"): topic for topic in recording.clouds()}


@lru_cache(maxsize=1)
def _kept(folder: Path, version: tuple[int, ...]) -> Recording:
    return Bag(folder, files_of(folder)) if is_bag(folder) else OusterRecording(folder)
