# SPDX-License-Identifier: MIT
"""Shrink a picture for the documentation: fewer pixels, and WebP.

python docs/shrink.py WIDTH PICTURE.png SHRUNK.webp
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import BinaryIO

from PIL import Image

QUALITY = 80


def shrink(png: Path | BinaryIO, webp: Path, width: int) -> None:
    """Write a picture as WebP of a width in pixels."""
    with Image.open(png) as large:
        size = (width, round(large.height * width / large.width))
        small = large.convert("RGB").resize(size, Image.Resampling.LANCZOS)
    small.save(webp, quality=QUALITY, method=6)


if __name__ == "__main__":
    shrink(Path(sys.argv[2]), Path(sys.argv[3]), int(sys.argv[1]))
