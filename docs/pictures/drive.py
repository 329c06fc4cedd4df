# SPDX-License-Identifier: MIT
"""Animate a drive, seen by a camera that turns slowly: classes, and probability of error."""

from __future__ import annotations

import tempfile
from collections import Counter
from pathlib import Path

import numpy as np
from PIL import Image
from prepared import predicted_drive

import salsanext_cli as sn
from pictures.keys import below_each_other, colour_bar, legend, title
from pictures.rendering import BACKGROUND, Camera, rendered
from salsanext_cli.report.colours import (
    FIXED_SCALES,
    legend_of,
    map_on_dark,
    screen_colours,
    value_colours,
)

WIDTH, HEIGHT = 397, 400
"""Size of a panel in pixels, without title and key."""
GAP_PX = 6
FRAMES_PER_SCAN = 4
FRAME_MS = 140
TURN_DEGREES = 28.0
"""Turn of the camera to either side."""
CLASSES = 6
"""Classes in the legend, the most frequent ones."""
ERRORS = FIXED_SCALES["error"]
SHADES = 20
"""Shades of the probability of error in the palette."""


def draw(data: Path, picture: Path) -> None:
    """Write the animation."""
    with tempfile.TemporaryDirectory() as folder:
        scans, results = predicted_drive(data, Path(folder), "--error")
        frames = drive_frames(scans, results)
    # One palette for all frames, and no dithering, so that equal areas stay equal.
    colours = palette()
    first, *others = [frame.quantize(palette=colours, dither=Image.Dither.NONE) for frame in frames]
    first.save(picture, save_all=True, append_images=others, duration=FRAME_MS, loop=0)


def drive_frames(scans: list[Path], results: Path) -> list[Image.Image]:
    """Return the frames: of each scan some, from a camera that turns to the left and right."""
    space = sn.label_space()
    labels = [
        space.to_train(sn.read_labels(results / "predictions" / f"{scan.stem}.label"))
        for scan in scans
    ]
    counts = Counter(np.concatenate(labels)[np.concatenate(labels) > 0].tolist())
    frequent = np.array([train_id for train_id, _ in counts.most_common(CLASSES)])
    class_key = legend(legend_of(space, frequent), WIDTH, 3)
    error_key = colour_bar(ERRORS, [f"{100 * mark:g}" for mark in ERRORS], WIDTH)
    count = len(scans) * FRAMES_PER_SCAN
    frames = []
    for number in range(count):
        scan = number // FRAMES_PER_SCAN
        points = sn.read_scan(scans[scan]).points
        classes = screen_colours(space)[labels[scan]]
        error = np.load(results / "uncertainty/error" / f"{scans[scan].stem}.npy")
        known = labels[scan] > 0
        errors = value_colours(error[known], *ERRORS)
        camera = Camera().turned(TURN_DEGREES * np.sin(2 * np.pi * number / count))
        panels = [
            panel("class", points[known], classes[known], camera, class_key),
            panel("probability that it is wrong, %", points[known], errors, camera, error_key),
        ]
        frames.append(beside_each_other(panels))
    return frames


def panel(
    name: str, points: np.ndarray, colours: np.ndarray, camera: Camera, key: Image.Image
) -> Image.Image:
    """Return the points below a title and above their key."""
    view = rendered(points, colours, WIDTH, HEIGHT, camera)
    return below_each_other([title(name, WIDTH), view, key])


def beside_each_other(panels: list[Image.Image]) -> Image.Image:
    """Put panels of one size side by side."""
    width = len(panels) * (WIDTH + GAP_PX) - GAP_PX
    sheet = Image.new("RGB", (width, panels[0].height), BACKGROUND)
    for number, part in enumerate(panels):
        sheet.paste(part, (number * (WIDTH + GAP_PX), 0))
    return sheet


def palette() -> Image.Image:
    """Return the colours of the animation: of classes and errors, each also half as bright."""
    shades = map_on_dark()[np.linspace(0, 255, SHADES).astype(int)]
    full = np.vstack([screen_colours(sn.label_space())[1:], shades, [[235, 235, 235]]])
    half = (full.astype(int) + BACKGROUND) // 2
    colours = np.vstack([[BACKGROUND], full, half]).astype(np.uint8)
    picture = Image.new("P", (1, 1))
    picture.putpalette(colours.tobytes())
    return picture
