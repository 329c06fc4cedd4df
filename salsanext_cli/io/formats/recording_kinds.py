# SPDX-License-Identifier: MIT
"""Kinds of recordings of many scans: ROS bags, packets of sensors, and E57 files.

A new kind is a row of `RECORDING_KINDS`, and a class with the methods of `Recording`. Its module is
imported when a recording of this kind is opened. `recordings.py` keeps it open, names its scans and
calls its methods. A recording is a file with one of its suffixes, or
a folder in which its `files_in` finds files.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from salsanext_cli.core.errors import FormatError, NoInputError

if TYPE_CHECKING:
    from salsanext_cli.core.poses import Poses
    from salsanext_cli.io.formats.columns import Columns

METADATA = "metadata.yaml"  # In the folder of a ROS 2 bag, beside `.db3` or `.mcap` files


class Recording(Protocol):
    """Recording that is open, with the clouds of some topics."""

    def cloud_topics(self) -> list[str]:
        """Return the topics with point clouds, sorted; a kind without topics returns one name.

        A topic is the folder of its scans in their paths.
        """

    def without_clouds(self) -> NoInputError:
        """Return the error of a recording without topics of point clouds."""

    def scan_keys(self, topic: str) -> list[int]:
        """Return the keys of the clouds of a topic, sorted.

        They are times in nanoseconds, or numbers from 0 of a kind without times.
        """

    def point_count(self, topic: str) -> int:
        """Return the usual number of points of a cloud of a topic."""

    def columns(self, topic: str, key: int, number: int, path: Path) -> Columns:
        """Read the cloud of a topic and a key.

        Parameters
        ----------
        topic : str
            Topic of point clouds.
        key : int
            One of the `scan_keys`.
        number : int
            Number of the cloud among those of the same key, from 0.
        path : Path
            Path of the scan, for errors.

        Returns
        -------
        Columns
            Values (N,) of each field, by name.
        """

    def poses(self) -> Poses | None:
        """Return the poses (N, 4, 4) float64 of the N scans in metres; None without poses."""


def no_files(folder: Path) -> Sequence[Path]:
    """Return the files of a kind whose recordings are files, in any folder: none."""
    return ()


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingKind:
    """Kind of recordings.

    Attributes
    ----------
    suffixes : tuple of str
        Suffixes of the files, in lower case.
    noun : str
        A recording of this kind in messages.
    open_files : callable
        Opens a recording by its path and the files that belong to it.
    key_digits : int
        Digits of the names of its scans, which are their keys.
    has_times : bool
        Whether the keys are times in nanoseconds; else they are numbers from 0.
    may_be_map : bool
        Whether map coordinates are moved into a local frame; else they are refused.
    files_in : callable
        Returns the files of a folder that is a recording of this kind; none for any other folder.
    """

    suffixes: tuple[str, ...]
    noun: str
    open_files: Callable[[Path, Sequence[Path]], Recording]
    key_digits: int = 19
    has_times: bool = True
    may_be_map: bool = False
    files_in: Callable[[Path], Sequence[Path]] = no_files


def _files_of_bag(folder: Path) -> Sequence[Path]:
    """Return the files of a ROS 2 bag; compressed messages are messages too."""
    from salsanext_cli.io.files.reading import present

    metadata = folder / METADATA
    if not present(metadata):
        return ()
    names = (path for path in folder.iterdir() if not path.name.startswith("."))
    messages = sorted(path for path in names if {".mcap", ".db3"} & {*path.suffixes})
    return [metadata, *messages] if messages else ()


def _open_bag(path: Path, files: Sequence[Path]) -> Recording:
    from salsanext_cli.io.formats.ros.bags import Bag

    return Bag(path, list(files))


def _open_velodyne_or_ouster(path: Path, _: Sequence[Path]) -> Recording:
    from salsanext_cli.io.formats.captures import VELODYNE, readable_maker

    if readable_maker(path) != VELODYNE:
        return _open_ouster(path, [path])
    from salsanext_cli.io.formats.velodyne import VelodyneCapture

    return VelodyneCapture(path)


def _open_ouster(path: Path, _: Sequence[Path]) -> Recording:
    from salsanext_cli.io.formats.ouster import OusterRecording

    return OusterRecording(path)


def _open_e57(path: Path, _: Sequence[Path]) -> Recording:
    from salsanext_cli.io.formats.survey.e57 import E57Recording

    return E57Recording(path)


BAG = RecordingKind(
    suffixes=(".bag", ".mcap", ".db3"),
    noun="a ROS bag",
    open_files=_open_bag,
    files_in=_files_of_bag,
)
CAPTURE = RecordingKind(
    suffixes=(".pcap",), noun="a capture of packets", open_files=_open_velodyne_or_ouster
)
OUSTER_FRAMES = RecordingKind(
    suffixes=(".osf",), noun="a recording of Ouster", open_files=_open_ouster
)
SITE = RecordingKind(
    suffixes=(".e57",),
    noun="an E57 file",
    open_files=_open_e57,
    key_digits=6,
    has_times=False,
    may_be_map=True,
)
RECORDING_KINDS = (BAG, CAPTURE, OUSTER_FRAMES, SITE)
RECORDING_SUFFIXES = tuple(suffix for kind in RECORDING_KINDS for suffix in kind.suffixes)
"""Suffixes of recordings that are files."""


def found_kind(path: Path) -> RecordingKind | None:
    """Return the kind of a recording by its suffix or the files in it; None for other paths."""
    from salsanext_cli.io.files.reading import is_folder

    if is_folder(path):
        return next((kind for kind in RECORDING_KINDS if kind.files_in(path)), None)
    suffix = path.suffix.lower()
    return next((kind for kind in RECORDING_KINDS if suffix in kind.suffixes), None)


def kind_of(recording: Path) -> RecordingKind:
    """Return the kind of a recording; anything else raises `FormatError`."""
    kind = found_kind(recording)
    if kind is None:
        raise FormatError(recording, "no such recording", "a recording or a scan in one")
    return kind
