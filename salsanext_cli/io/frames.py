# SPDX-License-Identifier: MIT
"""Frames of scans that were moved out of map coordinates, in a file beside the scans."""

import json
import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from salsanext_cli.core.errors import FormatError
from salsanext_cli.core.notices import warn_once
from salsanext_cli.core.plain_data import MALFORMED, decoded
from salsanext_cli.core.records import Origin
from salsanext_cli.core.texts import with_hint
from salsanext_cli.io.files.json_files import encode_json
from salsanext_cli.io.files.reading import filled, present, reading

FRAMES = "frames.json"
EXPECTED = "three finite numbers by scan"
HINT = (
    'for scans in map coordinates, give three metres by name, as {"000000": [460000, 5430000, 0]}'
)
HINT_OF_DAMAGE = (
    "if `pick`, `convert` or `filter` wrote the file, delete it and run that command again; if "
    f"another program wrote it, move it away; {HINT}"
)

log = logging.getLogger(__name__)


def encode_frames(frames: Mapping[str, Origin]) -> bytes:
    """Return the content of a file of frames: the origin of each, in metres, by name of the scan.

    The sum of a point and the origin of its scan is the point in map coordinates.
    """
    return encode_json({name: list(frame) for name, frame in sorted(frames.items())})


def read_frames(path: Path) -> dict[str, Origin]:
    """Read a file of frames; none if there is no such file.

    Other programs give this name to other files. A warning names such a file, which has no frames.

    Raises
    ------
    FormatError
        If the file cannot be read, is not JSON, or has a frame among damaged ones.
    """
    if not present(path):
        return {}
    content = _content(path)
    if not _has_frames(content):
        warn_once(log, with_hint(f"{path}: is not a file of frames, and is ignored", HINT))
        return {}
    try:
        frames = decoded(dict[str, tuple[float, float, float]], content)
        if not np.isfinite(list(frames.values())).all():
            raise ValueError("a frame that is not finite")
    except (*MALFORMED, OverflowError) as error:
        raise FormatError(path, "is damaged", EXPECTED, HINT_OF_DAMAGE) from error
    return frames


def read_written_frames(path: Path) -> dict[str, Origin]:
    """Read a file of frames of an output folder; an empty one, as after a power cut, has none.

    Raises
    ------
    FormatError
        As of `read_frames`.
    """
    return read_frames(path) if filled(path) else {}


def is_ignored(path: Path) -> bool:
    """Return whether `read_frames` ignores a file, which another program wrote."""
    return present(path) and not _has_frames(_content(path))


def _content(path: Path) -> Any:
    """Read a JSON file."""
    with reading(path) as file:
        text = file.read()
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise FormatError(path, "is damaged: is not JSON", EXPECTED, HINT_OF_DAMAGE) from error


def _has_frames(content: Any) -> bool:
    """Return whether JSON is that of frames, damaged or not: an object with lists of numbers."""
    return isinstance(content, dict) and (not content or any(map(_has_number, content.values())))


def _has_number(value: Any) -> bool:
    return isinstance(value, list) and any(isinstance(item, int | float) for item in value)
