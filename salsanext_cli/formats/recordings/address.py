# SPDX-License-Identifier: MIT
"""Paths of recordings, and of scans inside: ``drive.bag/velodyne_points/1612345678000000000``.

A scan of a recording is named as if the recording were a folder, of which the topics are folders
and the scans files. So it has a path as every scan has, which records and workers keep.
"""

from pathlib import Path

from salsanext_cli.files.reading import is_folder, present

BAG_SUFFIXES = (".bag", ".mcap", ".db3")
RECORDING_SUFFIXES = (*BAG_SUFFIXES, ".pcap", ".osf")
"""Suffixes of recordings that are files, upper or lower case."""
METADATA = "metadata.yaml"
"""File that makes a folder with `.db3` or `.mcap` files a ROS 2 bag."""


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
