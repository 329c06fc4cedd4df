# SPDX-License-Identifier: MIT
"""Recordings of many scans, read scan by scan: ROS bags and the packets of Ouster sensors.

A scan of a recording is named as if the recording were a folder, of which the topics are folders
and the scans files: ``drive.bag/velodyne_points/1612345678000000000``.
"""

import os
import re
from functools import lru_cache
from pathlib import Path
from typing import Protocol

from salsanext_cli.errors import FormatError, NoInputError, UsageError, shortened
from salsanext_cli.files.reading import is_folder, present
from salsanext_cli.formats.bags import Bag
from salsanext_cli.formats.columns import Columns, scan_of
from salsanext_cli.formats.ouster import OusterRecording
from salsanext_cli.records import Scan

BAG_SUFFIXES = (".bag", ".mcap", ".db3")
RECORDING_SUFFIXES = (*BAG_SUFFIXES, ".pcap", ".osf")
"""Suffixes of recordings that are files, upper or lower case."""
METADATA = "metadata.yaml"
"""File that makes a folder with `.db3` or `.mcap` files a ROS 2 bag."""
NAME = re.compile(r"(-?\d{1,20})(?:_(\d{1,9}))?", re.ASCII)
MAX_SHOWN = 500
"""Characters of a list of topics in an error."""


def is_recording(path: Path) -> bool:
    """Say whether a path is that of a recording: a file with its suffix, or a ROS 2 bag."""
    if is_folder(path):
        return present(path / METADATA) and bool(storages(path))
    return path.suffix.lower() in RECORDING_SUFFIXES and present(path)


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


class Recording(Protocol):
    """Recording of any kind, open for reading by any number of threads.

    Opening one raises `FormatError` if nothing of it can be read, and `MissingDependency` if the
    package that reads it is missing or too old.
    """

    def topics(self) -> dict[str, str]:
        """Return the type of the messages of every topic that has some."""

    def clouds(self) -> list[str]:
        """Return the topics of point clouds."""

    def times(self, topic: str) -> list[int]:
        """Return the times of the clouds of a topic in nanoseconds, sorted."""

    def columns(self, topic: str, time: int, number: int, path: Path) -> Columns:
        """Read the cloud of a topic and a time; of several of one time that of a number."""


def recorded_paths(path: Path) -> list[Path]:
    """Return the paths of the scans of a recording, sorted by time; no scan is read.

    `path`: a recording with one topic of point clouds; a topic in it; one of its scans.
    """
    recording = _of(path)
    opened = _opened(recording)
    inside = "/".join(path.relative_to(recording).parts)
    clouds = {topic.strip("/"): topic for topic in opened.clouds()}
    if not inside:
        inside = _only(clouds, recording, opened)
    topic, name = (inside, "") if inside in clouds else inside.rpartition("/")[::2]
    if topic not in clouds:
        listed = shortened(", ".join(opened.clouds()), MAX_SHOWN)
        raise NoInputError(recording, f"no clouds of topic {inside}", f"one of {listed}")
    names = _names(opened.times(clouds[topic]))
    if name and name not in names:
        raise NoInputError(path, "no such scan", f"one of the {len(names)} of the recording")
    return [recording / topic / each for each in names if name in ("", each)]


def _only(clouds: dict[str, str], recording: Path, opened: Recording) -> str:
    """Return the topic of a recording that has one."""
    if len(clouds) == 1:
        return next(iter(clouds))
    if clouds:
        listed = shortened(", ".join(clouds.values()), MAX_SHOWN)
        first = next(iter(clouds.values()))
        found = f"{len(clouds)} topics of point clouds: {listed}"
        raise UsageError(recording, found, "one of them", f"--topic {first}")
    others = ", ".join(f"{topic} ({kind})" for topic, kind in opened.topics().items())
    found = f"no point clouds, but {shortened(others, MAX_SHOWN)}" if others else "no messages"
    raise NoInputError(recording, found, "clouds, such as sensor_msgs/PointCloud2")


def _names(times: list[int]) -> list[str]:
    """Return the names of scans by their times in nanoseconds; an equal one gets a suffix."""
    names: list[str] = []
    seen: dict[int, int] = {}
    for time in times:
        number = seen[time] = seen.get(time, -1) + 1
        names.append(f"{time:019d}" + (f"_{number}" if number else ""))
    return names


def read_recorded(path: Path, intensity_scale: float) -> Scan:
    """Read a scan of a recording.

    `path`: one of `recorded_paths`; `intensity_scale`: divides the intensity, except that of bytes.
    """
    recording = _of(path)
    opened = _opened(recording)
    topic = "/".join(path.parent.relative_to(recording).parts)
    given = next((each for each in opened.clouds() if each.strip("/") == topic), None)
    match = NAME.fullmatch(path.name)
    if given is None or match is None:
        raise FormatError(path, "not there", "a scan that the recording lists")
    columns = opened.columns(given, int(match[1]), int(match[2] or 0), path)
    return scan_of(columns, path, intensity_scale)


def _of(path: Path) -> Path:
    recording = recording_of(path)
    if recording is None:
        raise FormatError(path, "no such recording", "a recording or a scan in one")
    return recording


def _opened(recording: Path) -> Recording:
    """Return a recording, kept open until another one is asked for."""
    # A file that is open in a forked process has one position in both.
    version = [os.getpid()]
    for file in files_of(recording):
        status = file.stat()
        version += [status.st_ino, status.st_size, status.st_mtime_ns]
    return _kept(recording, tuple(version))


@lru_cache(maxsize=1)
def _kept(recording: Path, version: tuple[int, ...]) -> Recording:
    if recording.is_dir() or recording.suffix.lower() in BAG_SUFFIXES:
        return Bag(recording, files_of(recording))
    return OusterRecording(recording)
