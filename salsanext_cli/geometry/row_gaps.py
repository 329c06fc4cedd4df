# SPDX-License-Identifier: MIT
"""Gaps between the rows of range images, as fewer beams than rows leave them."""

from collections.abc import Iterable

import numpy as np

from salsanext_cli.records import Float
from salsanext_cli.sensors.sensor import Sensor

MAX_GAP = 6
"""Most rows of a gap; larger ones are sky, or beams that returned nothing."""
FILLED_ROWS = 2
"""Rows within which a gap is filled: one more or less is worse on most scans."""
MORE_GAPS = 0.08
"""Difference to the gaps of training above which filling them makes labels better."""
DIGITS = 4


def row_gaps(images: Iterable[Float]) -> float | None:
    """Return the share of gaps among the pixels of points and gaps, None without a point.

    A gap are up to `MAX_GAP` empty pixels between two of points in a column.

    `images`: channels; a pixel of range 0 is empty.
    """
    gaps = occupied = 0
    for channels in images:
        full = channels[0] > 0
        row = np.arange(len(full))[:, None]
        above = np.maximum.accumulate(np.where(full, row, -len(full) - MAX_GAP), axis=0)
        below = np.minimum.accumulate(np.where(full, row, 2 * len(full))[::-1], axis=0)[::-1]
        gaps += int((~full & (below - above <= MAX_GAP + 1)).sum())
        occupied += int(full.sum())
    return round(gaps / (gaps + occupied), DIGITS) if occupied else None


def fills_rows(sensor: Sensor, trained: Sensor) -> bool:
    """Say whether scans have so many more gaps than those of training that they are filled."""
    own, of_training = sensor.row_gaps, trained.row_gaps
    return own is not None and of_training is not None and own > of_training + MORE_GAPS


def with_filled_gaps(channels: Float, sensor: Sensor, trained: Sensor) -> Float:
    """Return a range image with its gaps filled where `fills_rows` says so, as `fill_rows` does."""
    return fill_rows(channels) if fills_rows(sensor, trained) else channels


def fill_rows(channels: Float) -> Float:
    """Return a range image whose empty pixels hold the next point below, within `FILLED_ROWS`.

    `channels` (5, H, W) float32, a pixel of range 0 is empty.

    Returns (5, H, W) float32, a new array.
    """
    filled = channels.copy()
    for rows in range(1, FILLED_ROWS + 1):
        here, below = filled[:, :-rows], channels[:, rows:]
        np.copyto(here, below, where=here[0] <= 0)
    return filled
