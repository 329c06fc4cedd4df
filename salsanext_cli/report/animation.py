# SPDX-License-Identifier: MIT
"""Animations of the pictures of each sequence: GIF, and MP4 where ffmpeg is installed."""

from __future__ import annotations

import logging
import shutil
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from io import BytesIO
from itertools import chain
from pathlib import Path
from subprocess import DEVNULL, PIPE, Popen
from tempfile import TemporaryDirectory, TemporaryFile
from typing import TYPE_CHECKING, BinaryIO, cast

import numpy as np

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.errors import NOTICE, OutputError, UsageError, counted
from salsanext_cli.files.reading import refusing_damage
from salsanext_cli.report.canvas import NIGHT
from salsanext_cli.report.colours import OUTCOMES, Colours, map_on_dark, screen_colours
from salsanext_cli.results.layout import ScanFile
from salsanext_cli.results.output_run import OutputRun
from salsanext_cli.results.owned_folder import OwnedFolder

if TYPE_CHECKING:
    from PIL.Image import Image
LARGEST_PX = (1280, 1080)
PNG = "a picture", "draw it again: delete it, or --overwrite"
"""Expectation of a picture, and the remedy if it is broken."""
PALETTE, MOST_KEPT = 256, 192
"""Colours of a GIF, and how many of them may be chosen beforehand."""

log = logging.getLogger(__name__)


def _animation(out: Path, sequence: str, form: str) -> Path:
    return out / "sequences" / sequence / f"pictures.{form}"


def require_animations_replaceable(
    out: Path, animations: Collection[str], scans: Sequence[ScanFile]
) -> None:
    """Refuse to replace animations of other programs, before anything is drawn."""
    sequences = dict.fromkeys(scan.sequence for scan in scans)
    paths = [_animation(out, sequence, form) for form in animations for sequence in sequences]
    OwnedFolder(out).require_own(paths)


def animate(
    form: str,
    frames_per_second: float,
    scans: Sequence[ScanFile],
    space: LabelSpace,
    output: OutputRun,
) -> None:
    """Write an animation of each sequence of which there are pictures."""
    # Every fifth colour of the map, from the high end.
    kept = np.concatenate([OUTCOMES, map_on_dark()[::-5], screen_colours(space)])
    for sequence in dict.fromkeys(scan.sequence for scan in scans):
        drawn = [output.path(scan, "pictures") for scan in scans if scan.sequence == sequence]
        pictures = [path for path in drawn if path.exists()]
        if not pictures:
            continue
        path = _animation(output.root, sequence, form)
        if form == "gif":
            output.write(path, encode_gif(pictures, frames_per_second, kept))
        else:
            output.write(path, encode_mp4(pictures, frames_per_second))
        log.log(NOTICE, "animation of %s: %s", counted(len(pictures), "scan"), path)


def find_ffmpeg() -> str:
    """Return the path of ffmpeg."""
    if path := shutil.which("ffmpeg"):
        return path
    raise UsageError("--mp4", "no ffmpeg found", "it on the PATH", "install it, or use --gif")


def frames(pictures: Sequence[Path]) -> Iterator[Image]:
    """Yield pictures reduced to frames of one size, even in width and height, at the upper left."""
    from PIL import Image

    sizes = []
    for path in pictures:
        with refusing_damage(path, *PNG), Image.open(path) as picture:
            sizes.append(picture.size)
    width, height = np.max(sizes, axis=0).tolist()
    share = min(1.0, LARGEST_PX[0] / width, LARGEST_PX[1] / height)
    size = (_even(width * share), _even(height * share))
    for path in pictures:
        whole = Image.new("RGB", (width, height), NIGHT)
        with refusing_damage(path, *PNG), Image.open(path) as picture:
            whole.paste(picture.convert("RGB"), (0, 0))
        yield whole.resize(size, Image.Resampling.LANCZOS, reducing_gap=3.0)


def encode_gif(pictures: Sequence[Path], frames_per_second: float, kept: Colours) -> bytes:
    """Return pictures as the content of a GIF file that repeats; colours `kept` (N, 3) stay."""
    from PIL import Image

    exact = list(dict.fromkeys(map(tuple, kept.tolist())))[:MOST_KEPT]
    rest = next(frames(pictures)).quantize(PALETTE - len(exact)).getpalette() or []
    palette = Image.new("P", (1, 1))
    palette.putpalette([value for colour in exact for value in colour] + rest)
    # Without dithering what does not move stays as it is.
    still = Image.Dither.NONE
    reduced = (frame.quantize(palette=palette, dither=still) for frame in frames(pictures))
    content, duration = BytesIO(), round(1000 / frames_per_second)
    first = next(reduced)
    first.save(content, "GIF", save_all=True, append_images=reduced, duration=duration, loop=0)
    return content.getvalue()


def encode_mp4(pictures: Sequence[Path], frames_per_second: float) -> bytes:
    """Return pictures as the content of an MP4 file, H.264 as browsers show it."""
    rest = frames(pictures)
    first = next(rest)
    size = f"{first.width}x{first.height}"
    command = [find_ffmpeg(), "-v", "error", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", size]
    command += ["-framerate", f"{frames_per_second:g}", "-i", "-", "-c:v", "libx264"]
    command += ["-pix_fmt", "yuv420p", "-movflags", "+faststart"]
    with TemporaryDirectory() as folder, TemporaryFile() as errors:
        made = Path(folder) / "made.mp4"
        with (
            Popen([*command, str(made)], stdin=PIPE, stdout=DEVNULL, stderr=errors) as ffmpeg,
            # If it ends before it has read all, it says why.
            suppress(BrokenPipeError),
            cast("BinaryIO", ffmpeg.stdin) as pipe,
        ):
            for frame in chain([first], rest):
                pipe.write(frame.tobytes())
        if ffmpeg.returncode:
            errors.seek(0)
            lines = errors.read().decode("utf-8", "replace").strip().splitlines()
            found = f"ffmpeg ended with status {ffmpeg.returncode}: {' '.join(lines[:1])}"
            raise OutputError(made.name, found, remedy="use --gif")
        return made.read_bytes()


def _even(pixels: float) -> int:
    return max(2, round(pixels / 2) * 2)
