# SPDX-License-Identifier: MIT
"""Animations of the pictures of each sequence in an output folder."""

import logging
from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.errors import NOTICE, counted
from salsanext_cli.report.animation import encode_gif, encode_mp4
from salsanext_cli.report.colours import OUTCOMES, map_on_dark, screen_colours
from salsanext_cli.results.layout import ScanFile
from salsanext_cli.results.output_run import OutputRun
from salsanext_cli.results.written_files import WrittenFiles

log = logging.getLogger(__name__)


def _animation(out: Path, sequence: str, form: str) -> Path:
    return out / "sequences" / sequence / f"pictures.{form}"


def require_animations_replaceable(
    out: Path, animations: Collection[str], scans: Sequence[ScanFile]
) -> None:
    """Refuse to replace animations of other programs, before anything is drawn."""
    sequences = dict.fromkeys(scan.sequence for scan in scans)
    paths = [_animation(out, sequence, form) for form in animations for sequence in sequences]
    WrittenFiles(out).require_replaceable(paths)


def animate(
    form: str,
    frames_per_second: float,
    scans: Sequence[ScanFile],
    space: LabelSpace,
    output: OutputRun,
) -> None:
    """Write an animation of each sequence of which there are pictures."""
    files = WrittenFiles(output.out)
    # Every fifth colour of the map, from the high end.
    kept = np.concatenate([OUTCOMES, map_on_dark()[::-5], screen_colours(space)])
    for sequence in dict.fromkeys(scan.sequence for scan in scans):
        mine = (scan for scan in scans if scan.sequence == sequence)
        pictures = [
            path for path in (output.path(scan, "pictures") for scan in mine) if path.exists()
        ]
        path = _animation(output.out, sequence, form)
        if not pictures:
            continue
        if form == "gif":
            files.write(path, encode_gif(pictures, frames_per_second, kept))
        else:
            files.write(path, encode_mp4(pictures, frames_per_second))
        log.log(NOTICE, "animation of %s: %s", counted(len(pictures), "scan"), path)
