# SPDX-License-Identifier: MIT
"""Animations of the pictures of each sequence, as GIF."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.errors import NOTICE, counted
from salsanext_cli.files.reading import refusing_damage
from salsanext_cli.report.canvas import NIGHT
from salsanext_cli.report.colours import OUTCOMES, Colours, map_on_dark, screen_colours
from salsanext_cli.results.layout import ScanFile
from salsanext_cli.results.output_run import OutputRun

if TYPE_CHECKING:
    from PIL.Image import Image
MAX_PX = (1280, 1080)
PALETTE, MAX_KEPT = 256, 192  # Colours of a GIF, and how many are chosen beforehand

log = logging.getLogger(__name__)


def animation_path(out: Path, sequence: str) -> Path:
    """Return where the animation of a sequence lies."""
    return out / "sequences" / sequence / "pictures.gif"


def animate(
    frames_per_second: float, scans: Sequence[ScanFile], space: LabelSpace, output: OutputRun
) -> None:
    """Write an animation of each sequence of which there are pictures."""
    # Every fifth colour of the map, from the high end.
    kept = np.concatenate([OUTCOMES, map_on_dark()[::-5], screen_colours(space)])
    for sequence in dict.fromkeys(scan.sequence for scan in scans):
        drawn = [output.path(scan, "pictures") for scan in scans if scan.sequence == sequence]
        pictures = [path for path in drawn if path.exists()]
        if pictures:
            path = animation_path(output.root, sequence)
            output.write(path, encode_gif(pictures, frames_per_second, kept))
            log.log(NOTICE, "animation of %s: %s", counted(len(pictures), "scan"), path)


def encode_gif(pictures: Sequence[Path], frames_per_second: float, kept: Colours) -> bytes:
    """Return pictures as the content of a GIF file that repeats; colours `kept` (N, 3) stay."""
    from PIL import Image

    exact = list(dict.fromkeys(map(tuple, kept.tolist())))[:MAX_KEPT]
    rest = next(_frames(pictures)).quantize(PALETTE - len(exact)).getpalette() or []
    palette = Image.new("P", (1, 1))
    palette.putpalette([value for colour in exact for value in colour] + rest)
    # Without dithering what does not move stays as it is.
    still = Image.Dither.NONE
    first, *others = (frame.quantize(palette=palette, dither=still) for frame in _frames(pictures))
    content, duration = BytesIO(), round(1000 / frames_per_second)
    first.save(content, "GIF", save_all=True, append_images=others, duration=duration, loop=0)
    return content.getvalue()


def _frames(pictures: Sequence[Path]) -> Iterator[Image]:
    """Yield pictures reduced to frames of one size, at the upper left."""
    from PIL import Image

    size = np.max([_read(path).size for path in pictures], axis=0).tolist()
    for path in pictures:
        frame = Image.new("RGB", size, NIGHT)
        frame.paste(_read(path))
        frame.thumbnail(MAX_PX)
        yield frame


def _read(path: Path) -> Image:
    from PIL import Image

    remedy = "draw it again: delete it, or --overwrite"
    with refusing_damage(path, "a picture", remedy), Image.open(path) as picture:
        return picture.convert("RGB")
