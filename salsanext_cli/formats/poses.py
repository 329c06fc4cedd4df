# SPDX-License-Identifier: MIT
"""Poses of the scans of a sequence, `poses.txt`: a line of text for each."""

from collections.abc import Sequence
from pathlib import Path

from salsanext_cli.errors import FormatError, counted
from salsanext_cli.files.reading import reading


def pose_lines(path: Path, scans: Sequence[str], wanted: Sequence[str]) -> bytes:
    """Return the lines of some scans of a sequence, in their order.

    A file with a line for each scan that is there is in the order of their names; in another one,
    as KITTI's of a whole drive, a scan's name is the number of its line, from 0.

    `path`: the file; `scans`: names of all scans of the sequence that are there, sorted, without
    suffix; `wanted`: those of some of them.
    """
    with reading(path) as file:
        lines = [line.strip() for line in file.read().splitlines() if line.strip()]
    if len(lines) == len(scans):
        places = [scans.index(name) for name in wanted]
    else:
        places = [int(name) if name.isdecimal() else len(lines) for name in wanted]
    if max(places, default=-1) >= len(lines):
        expected = f"one for each of {counted(len(scans), 'scan')}, or names that are line numbers"
        raise FormatError(path, counted(len(lines), "line"), expected)
    return b"".join(lines[place] + b"\n" for place in places)
