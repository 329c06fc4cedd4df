# SPDX-License-Identifier: MIT
import io
import shutil
import stat
import sys

import numpy as np
import pytest
from PIL import Image

from salsanext_cli.errors import FormatError, OutputError
from salsanext_cli.report.animation import (
    LARGEST_PX,
    encode_gif,
    encode_mp4,
    frames,
)

RED, GREEN, RARE = (255, 0, 0), (0, 175, 0), (30, 40, 250)
KEPT = np.array([RED, GREEN, RARE], np.uint8)


@pytest.fixture
def picture(tmp_path):
    """Return a function that writes a picture of noise with a block of a colour at its left."""

    def write(colour, width=300, height=200):
        noise = np.random.default_rng(height).integers(0, 256, (height, width, 3))
        noise[50:100, 20:60] = colour
        path = tmp_path / f"{len(list(tmp_path.iterdir()))}.png"
        Image.fromarray(noise.astype(np.uint8)).save(path)
        return path

    return write


def test_frames_have_one_size_that_encoders_take(picture):
    made = list(frames([picture(RED, 301, 201), picture(GREEN, 280, 150)]))
    assert [frame.size for frame in made] == [(300, 200), (300, 200)]
    assert made[1].getpixel((299, 199)) == (18, 19, 22)
    (large,) = frames([picture(RED, 300, 2160)])
    assert large.size == (150, LARGEST_PX[1])


def test_a_gif_shows_every_picture_in_turn_for_ever(picture):
    content = encode_gif([picture(RED), picture(GREEN), picture(RARE)], 4.0, KEPT)
    with Image.open(io.BytesIO(content)) as gif:
        assert (gif.n_frames, gif.info["loop"], gif.info["duration"]) == (3, 0, 250)
        for number, colour in enumerate((RED, GREEN, RARE)):
            gif.seek(number)
            # Exactly, among noise that takes all of the palette.
            assert gif.convert("RGB").getpixel((40, 75)) == colour


def test_what_is_no_picture_is_named(picture, tmp_path):
    broken = picture(RED)
    broken.write_bytes(broken.read_bytes()[:500])
    text = tmp_path / "text.png"
    text.write_text("no picture")
    for path in (broken, text, tmp_path / "absent.png"):
        with pytest.raises(FormatError, match=r"png · (damaged or cut off|cannot be read)"):
            encode_gif([picture(RED), path], 4.0, KEPT)


@pytest.fixture
def ffmpeg(tmp_path, monkeypatch):
    """Return a function that puts a program in the place of ffmpeg."""

    def install(body):
        program = tmp_path / "bin/ffmpeg"
        program.parent.mkdir()
        program.write_text(f"#!{sys.executable}\nimport sys, pathlib\n{body}\n")
        program.chmod(program.stat().st_mode | stat.S_IXUSR)
        monkeypatch.setenv("PATH", str(program.parent))

    return install


def test_ffmpeg_is_given_the_frames_in_order(picture, ffmpeg):
    pictures = [picture(RED), picture(GREEN)]
    ffmpeg(
        "frames = sys.stdin.buffer.read()\n"
        "given = [sys.argv[sys.argv.index(name) + 1] for name in ('-s', '-framerate')]\n"
        "pathlib.Path(sys.argv[-1]).write_bytes(' '.join(given).encode() + b':' + frames)"
    )
    given, _, pixels = encode_mp4(pictures, 2.5).partition(b":")
    assert given == b"300x200 2.5"
    made = np.frombuffer(pixels, np.uint8).reshape(2, 200, 300, 3)
    assert [tuple(frame[75, 40]) for frame in made] == [RED, GREEN]


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="ffmpeg is not installed")
def test_the_real_one_makes_a_film(picture):
    film = encode_mp4([picture(RED), picture(GREEN)], 2.5)
    assert film[4:8] == b"ftyp"


def test_an_ffmpeg_that_fails_is_quoted(picture, ffmpeg):
    ffmpeg("sys.exit('Unknown encoder libx264')")
    with pytest.raises(OutputError, match="ffmpeg ended with status 1: Unknown encoder libx264"):
        encode_mp4([picture(RED)] * 9, 2.5)
