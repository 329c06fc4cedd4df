# SPDX-License-Identifier: MIT
"""Frames of scans that were moved out of map coordinates, in a file beside the scans."""

from collections.abc import Mapping
from pathlib import Path

from salsanext_cli.core.errors import FormatError
from salsanext_cli.core.records import Origin
from salsanext_cli.io.files.json_files import encode_json, read_json

FRAMES = "frames.json"


def encode_frames(frames: Mapping[str, Origin]) -> bytes:
    """Return the content of a file of frames: the origin of each, in metres, by name of the scan.

    The sum of a point and the origin of its scan is the point in map coordinates.
    """
    return encode_json({name: list(frame) for name, frame in sorted(frames.items())})


def read_frames(path: Path) -> dict[str, Origin]:
    """Read a file of frames; none if there is no such file."""
    try:
        data = read_json(path) or {}
        frames = {str(name): tuple(map(float, frame)) for name, frame in data.items()}
    except (TypeError, ValueError) as error:
        raise FormatError(path, "is not a file of frames", "three numbers by scan") from error
    if any(len(frame) != 3 for frame in frames.values()):
        raise FormatError(path, "is not a file of frames", "three numbers by scan")
    return frames
