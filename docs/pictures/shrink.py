# SPDX-License-Identifier: MIT
"""Shrink a picture for the documentation: fewer pixels, and WebP."""

from __future__ import annotations

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
