# SPDX-License-Identifier: MIT
"""Frames of scans that were moved out of map coordinates, in a file beside the scans."""

import json
import logging
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from salsanext_cli.core.notices import warn_once
from salsanext_cli.core.plain_data import MALFORMED, decoded
from salsanext_cli.core.records import Origin
from salsanext_cli.core.texts import with_hint
from salsanext_cli.io.files.json_files import encode_json
from salsanext_cli.io.files.reading import present, reading

FRAMES = "frames.json"
HINT = (
    'for scans in map coordinates, give three metres by name, as {"000000": [460000, 5430000, 0]}'
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
    """
    if not present(path):
        return {}
    with reading(path) as file:
        content = file.read()
    try:
        frames = decoded(dict[str, tuple[float, float, float]], json.loads(content))
        if not np.isfinite(list(frames.values())).all():
            raise ValueError("a frame that is not finite")
    except MALFORMED:
        warn_once(log, with_hint(f"{path}: is not a file of frames, and is ignored", HINT))
        return {}
    return frames
