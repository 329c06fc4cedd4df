# SPDX-License-Identifier: MIT
"""Draw range images of scans, below each other: range on the left, intensity on the right.

    python docs/range_pictures.py PICTURE.webp SCAN...

Near is bright. The pictures of docs/how-to/synthetic.md were made so, with 64×512 pixels.
"""

import sys
from pathlib import Path

import numpy as np
from PIL import Image

import salsanext_cli as sn

SENSOR = "hdl64-512"
NEAR_M, FAR_M = 2.0, 80.0
ROW_HEIGHT_PX, GAP_PX, QUALITY = 2, 6, 60


def strips(path: Path) -> np.ndarray:
    """Return range and intensity of a scan as grey values, (H, 2 W + gap) uint8."""
    channels = sn.project(sn.read_scan(path), sn.sensor(SENSOR)).channels
    full = channels[0] > 0
    nearness = np.log(FAR_M / np.clip(channels[0], NEAR_M, FAR_M)) / np.log(FAR_M / NEAR_M)
    bright = np.quantile(channels[4][full], 0.95)
    intensity = np.sqrt(np.clip(channels[4] / bright, 0, 1))
    gap = np.full((len(full), GAP_PX), 255, np.uint8)
    grey = [(255 * np.where(full, each, 0)).astype(np.uint8) for each in (nearness, intensity)]
    return np.repeat(np.hstack([grey[0], gap, grey[1]]), ROW_HEIGHT_PX, axis=0)


def main(picture: str, *scans: str) -> None:
    """Draw the scans."""
    rows = [strips(Path(scan)) for scan in scans]
    gap = np.full((GAP_PX, rows[0].shape[1]), 255, np.uint8)
    sheet = np.vstack([each for row in rows for each in (row, gap)])
    Image.fromarray(sheet).save(picture, quality=QUALITY, method=6)


if __name__ == "__main__":
    main(*sys.argv[1:])
