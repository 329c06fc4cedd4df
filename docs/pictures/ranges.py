# SPDX-License-Identifier: MIT
"""Draw range images of real and simulated scans: range on the left, intensity on the right."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from measurements import salsanext

import salsanext_cli as sn
from pictures.concepts import INTENSITIES, RANGES_M, SHADES
from pictures.sheets import colour_bar, panels, save, sheet, titled
from salsanext_cli.report.colours import value_colours

SENSOR = "hdl64-512"
COUNT = 6


def real(data: Path, picture: Path) -> None:
    """Draw scans of SemanticKITTI."""
    scans = sorted((data / "semantickitti/sequences").glob("*/velodyne/*.bin"))
    # Neighbours in this order are often of the same place.
    draw(scans[:: len(scans) // COUNT][:COUNT], picture)


def simulated(_: Path, picture: Path) -> None:
    """Draw simulated scans, each from another sequence."""
    with tempfile.TemporaryDirectory() as folder:
        salsanext("synth", folder, "--overwrite", "--train", COUNT, "--valid", 0, "--scans", 1)
        draw(sorted(Path(folder).glob("sequences/*/velodyne/*.bin")), picture)


def draw(scans: list[Path], picture: Path) -> None:
    """Draw scans below each other, and the scales of both columns below them."""
    figure = sheet(1.45 * len(scans) + 0.9)
    axes = panels(figure, len(scans) + 1, 2, height_ratios=[6] * len(scans) + [1])
    titled(axes[0], "range, m")
    titled(axes[1], "intensity, from 0 to 1")
    for row, scan in enumerate(scans):
        channels = sn.project(sn.read_scan(scan), sn.sensor(SENSOR)).channels
        full = channels[0] > 0
        columns = ((channels[0], RANGES_M, SHADES[::-1]), (channels[4], INTENSITIES, SHADES))
        for column, (values, marks, shades) in enumerate(columns):
            strip = value_colours(np.where(full, values, np.nan), *marks, colour_map=shades)
            axes[2 * row + column].imshow(strip, aspect="auto", interpolation="nearest")
    colour_bar(axes[-2], RANGES_M, SHADES[::-1])
    colour_bar(axes[-1], INTENSITIES, SHADES)
    save(figure, picture)
