# SPDX-License-Identifier: MIT
"""Animate a drive: labels, probability of error, labels without rejected ones."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from PIL import Image
from prepared import predicted_drive

import salsanext_cli as sn
from pictures.rendering import BACKGROUND, error_colours, in_a_row, rendered

WIDTH, HEIGHT = 400, 320
FRAME_MS = 400
COLOURS = 96
LIMIT = 0.1
"""Probability of error above which a label is rejected."""


def draw(data: Path, picture: Path) -> None:
    """Write the animation."""
    with tempfile.TemporaryDirectory() as folder:
        scans, results = predicted_drive(data, Path(folder), "--error")
        frames = [
            frame(
                scan,
                sn.read_labels(results / "predictions" / f"{scan.stem}.label"),
                np.load(results / "uncertainty/error" / f"{scan.stem}.npy"),
            )
            for scan in scans
        ]
    # One palette for all frames, and no dithering, so that equal areas stay equal.
    together = Image.fromarray(np.vstack([np.asarray(frame) for frame in frames]))
    palette = together.quantize(COLOURS, Image.Quantize.MEDIANCUT)
    first, *others = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    first.save(picture, save_all=True, append_images=others, duration=FRAME_MS, loop=0)


def frame(scan: Path, labels: np.ndarray, error: np.ndarray) -> Image.Image:
    """Return the three pictures of a scan side by side."""
    space = sn.label_space()
    points = sn.read_scan(scan).points
    classes = space.colours[space.to_train(labels)]
    classes[labels == 0] = BACKGROUND
    accepted = np.where((error > LIMIT)[:, None], np.uint8([70, 74, 82]), classes)
    views = {
        "labels": classes,
        "probability of error": error_colours(error),
        f"labels with error below {LIMIT:.0%}": accepted,
    }
    return in_a_row([(t, rendered(points, c, WIDTH, HEIGHT)) for t, c in views.items()])
