# SPDX-License-Identifier: MIT
import io

import numpy as np
import pytest
from PIL import Image

from salsanext_cli.errors import FormatError
from salsanext_cli.report.animation import MAX_PX, encode_gif

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


def gif_of(*pictures):
    return Image.open(io.BytesIO(encode_gif(pictures, 4.0, KEPT)))


def test_frames_of_one_size_show_every_picture_in_turn_for_ever(picture):
    gif = gif_of(picture(RED, 301, 201), picture(GREEN, 280, 250))
    assert gif.size == (301, 250)
    assert sum(gif.convert("RGB").getpixel((300, 249))) < 100  # below the picture it is night
    assert gif_of(picture(RED, 300, 2160)).size == (150, MAX_PX[1])
    gif = gif_of(picture(RED), picture(GREEN), picture(RARE))
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
            gif_of(picture(RED), path)
