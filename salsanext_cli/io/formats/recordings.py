# SPDX-License-Identifier: MIT
"""Recordings of many scans, read scan by scan: their topics, scans and poses by path.

The path of a scan treats recording and topic as folders:
``drive.bag/velodyne_points/1612345678000000000``.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from functools import lru_cache
from itertools import groupby
from pathlib import Path

from salsanext_cli.core.errors import FormatError, NoInputError, UsageError
from salsanext_cli.core.poses import Poses
from salsanext_cli.core.records import Scan
from salsanext_cli.core.texts import counted, shortened
from salsanext_cli.core.wording import part
from salsanext_cli.io.files.reading import identity, is_folder, present
from salsanext_cli.io.formats.columns import scan_of
from salsanext_cli.io.formats.recording_kinds import (
    BAG,
    Recording,
    RecordingKind,
    found_kind,
    kind_of,
)

NAME = re.compile(r"(-?\d{1,20})(?:_(\d{1,9}))?", re.ASCII)
MAX_SHOWN = 500  # Characters of a list of topics in an error


def is_recording(path: Path) -> bool:
    """Return whether a path is a file with the suffix of a recording, or such a folder."""
    return found_kind(path) is not None and present(path)


def files_of(recording: Path) -> list[Path]:
    """Return the files of a recording."""
    return [*kind_of(recording).files_in(recording)] if is_folder(recording) else [recording]


def recording_of(path: Path) -> Path | None:
    """Return the recording that a path is or leads into; None for any other path."""
    existing = next((place for place in [path, *path.parents] if present(place)), None)
    return existing if existing is not None and is_recording(existing) else None


def reachable_recording(path: Path) -> Path | None:
    """Return the recording of `recording_of`; None also if the system does not let it be found."""
    try:
        return recording_of(path)
    except FormatError:
        return None


def sequence_of(recording: Path) -> str:
    """Return the name of the sequence of a recording."""
    return recording.name if is_folder(recording) else recording.stem


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _OpenRecording:
    """Recording that is open, where it lies, and its topics."""

    folder: Path  # Path of the recording, which is a folder of its topics
    recording: Recording
    topics: dict[str, str]  # Topics of point clouds by the names of their folders


def recorded_paths(path: Path) -> list[Path]:
    """Return the paths of the scans in a recording, a topic or a scan of it, sorted by time."""
    opened = _open_recording(path)
    folder = opened.folder
    clouds = opened.topics
    inside = "/".join(path.relative_to(folder).parts) or _only_topic(opened)
    topic = inside
    name = ""
    if inside not in clouds:
        topic, _, name = inside.rpartition("/")
    if topic not in clouds:
        listed = shortened(", ".join(clouds.values()), MAX_SHOWN)
        raise NoInputError(folder, f"has no clouds of topic {inside}", f"one of {listed}")
    names = _names(opened.recording.scan_keys(clouds[topic]), kind_of(folder))
    if name and name not in names:
        raise NoInputError(path, "no such scan", f"one of the {len(names)} of the recording")
    return [folder / topic / stem for stem in names if name in ("", stem)]


def _only_topic(opened: _OpenRecording) -> str:
    """Return the folder of the only topic of point clouds of a recording."""
    if len(opened.topics) == 1:
        return next(iter(opened.topics))
    if opened.topics:
        topics = list(opened.topics.values())
        raise _several_topics(opened.folder, opened.recording, topics)
    raise opened.recording.without_clouds()


def _several_topics(folder: Path, recording: Recording, topics: list[str]) -> UsageError:
    """Return the error of a recording with several topics, those with most points first."""
    points = {topic: recording.point_count(topic) for topic in topics}
    ordered = sorted(topics, key=lambda topic: (-points[topic], topic))
    texts = [f"{topic} ({counted(points[topic], 'point')})" for topic in ordered]
    problem = f"has {len(topics)} topics of point clouds: {shortened(', '.join(texts), MAX_SHOWN)}"
    hint = f"choose one with {part('topic', folder, ordered[0])}"
    return UsageError(folder, problem, "one of them", hint)


def _names(keys: list[int], kind: RecordingKind) -> list[str]:
    """Return the names of scans by their sorted keys; equal keys get a suffix."""
    return [
        scan_name(key, number, kind)
        for key, equal in groupby(keys)
        for number, _ in enumerate(equal)
    ]


def scan_name(key: int, number: int, kind: RecordingKind = BAG) -> str:
    """Return the name of a scan by its key and its number among equal keys."""
    return f"{key:0{kind.key_digits}d}" + (f"_{number}" if number else "")


def recorded_scan(path: Path, intensity_scale: float, intensity_field: str = "") -> Scan:
    """Read a scan of a recording, whose path is one of the `recorded_paths`.

    `intensity_scale`, `intensity_field`: as of `scan_of`.
    """
    opened = _open_recording(path)
    topic = "/".join(path.parent.relative_to(opened.folder).parts)
    match = NAME.fullmatch(path.name)
    if topic not in opened.topics or match is None:
        raise FormatError(path, "no such scan", "a scan that the recording lists")
    key = int(match[1])
    number = int(match[2] or 0)
    columns = opened.recording.columns(opened.topics[topic], key, number, path)
    may_be_map = kind_of(opened.folder).may_be_map
    return scan_of(columns, path, intensity_scale, intensity_field, may_be_map=may_be_map)


def recorded_poses(path: Path) -> Poses | None:
    """Return the poses (N, 4, 4) of the N scans of a recording, which a path is or leads into.

    None if the recording has none.
    """
    return None if recording_of(path) is None else _open_recording(path).recording.poses()


def _open_recording(path: Path) -> _OpenRecording:
    """Return the recording that a path is or leads into, which stays open."""
    folder = recording_of(path)
    if folder is None:
        raise FormatError(path, "no such recording", "a recording or a scan in one")
    # An open file of a forked process has one position in both.
    versions = [identity(file) for file in files_of(folder)]
    recording = _recording(folder, (os.getpid(), *versions))
    topics = {topic.strip("/"): topic for topic in recording.cloud_topics()}
    return _OpenRecording(folder=folder, recording=recording, topics=topics)


@lru_cache(maxsize=1)
def _recording(path: Path, version: tuple[object, ...]) -> Recording:
    return kind_of(path).open_files(path, files_of(path))
