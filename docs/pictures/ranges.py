# SPDX-License-Identifier: MIT
"""Draw range images of real and simulated scans: range on the left, intensity on the right."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from measurements import salsanext
from PIL import Image

import salsanext_cli as sn

SENSOR = "hdl64-512"
NEAR_M, FAR_M = 2.0, 80.0
ROW_HEIGHT_PX, GAP_PX, QUALITY = 2, 6, 60
COUNT = 10


def real(data: Path, picture: Path) -> None:
    """Draw scans of SemanticKITTI."""
    draw(sorted((data / "semantickitti/sequences").glob("*/velodyne/*.bin"))[:COUNT], picture)


def simulated(_: Path, picture: Path) -> None:
    """Draw simulated scans, each from another sequence."""
    with tempfile.TemporaryDirectory() as folder:
        salsanext("synth", folder, "--overwrite", "--train", COUNT, "--valid", 0, "--scans", 1)
        draw(sorted(Path(folder).glob("sequences/*/velodyne/*.bin")), picture)


def draw(scans: list[Path], picture: Path) -> None:
    """Draw scans below each other."""
    rows = [strips(scan) for scan in scans]
    gap = np.full((GAP_PX, rows[0].shape[1]), 255, np.uint8)
    sheet = np.vstack([part for row in rows for part in (row, gap)])
    Image.fromarray(sheet).save(picture, quality=QUALITY, method=6)


def strips(path: Path) -> np.ndarray:
    """Return range and intensity of a scan as grey values, (H, 2 W + gap) uint8; near is bright."""
    channels = sn.project(sn.read_scan(path), sn.sensor(SENSOR)).channels
    full = channels[0] > 0
    nearness = np.log(FAR_M / np.clip(channels[0], NEAR_M, FAR_M)) / np.log(FAR_M / NEAR_M)
    bright = np.quantile(channels[4][full], 0.95)
    intensity = np.sqrt(np.clip(channels[4] / bright, 0, 1))
    gap = np.full((len(full), GAP_PX), 255, np.uint8)
    grey = [(255 * np.where(full, value, 0)).astype(np.uint8) for value in (nearness, intensity)]
    return np.repeat(np.hstack([grey[0], gap, grey[1]]), ROW_HEIGHT_PX, axis=0)
