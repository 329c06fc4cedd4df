# SPDX-License-Identifier: MIT
"""Gaps that sparser beams leave between the rows of a range image, and how they are filled."""

from collections.abc import Iterable

import numpy as np

from salsanext_cli.core.records import Float
from salsanext_cli.core.sensors.sensor import Sensor

MAX_GAP = 6  # Most rows of a gap; larger ones are sky or missing returns
BEYOND = MAX_GAP + 1  # Rows outside the image at which no point ends a gap
FILLED_ROWS = 2  # Rows within which a gap is filled: one more or less is worse on most scans
MORE_GAPS = 0.08  # Excess of gaps over training above which filling improves labels
GAP_DIGITS = 4


def row_gaps(images: Iterable[Float]) -> float | None:
    """Return the share of gaps among the pixels with a point or in a gap.

    A gap is at most `MAX_GAP` empty pixels of a column between two pixels with points.

    Parameters
    ----------
    images : iterable of (5, H, W) float32
        Range images.

    Returns
    -------
    float or None
        Share, 0…1; None if no image has a pixel with a point.
    """
    gaps = 0
    occupied = 0
    for channels in images:
        full = channels[0] > 0
        height = len(full)
        row = np.arange(height)[:, None]
        # Rows of the nearest points in the column, beyond the image where there are none
        above = np.maximum.accumulate(np.where(full, row, -BEYOND), axis=0)
        below = np.minimum.accumulate(np.where(full, row, height + BEYOND)[::-1], axis=0)[::-1]
        gaps += int((~full & (below - above <= MAX_GAP + 1)).sum())
        occupied += int(full.sum())
    return round(gaps / (gaps + occupied), GAP_DIGITS) if occupied else None


def column_gaps(images: Iterable[Float]) -> float | None:
    """Return the share of gaps between the columns of range images, as `row_gaps` of rows."""
    return row_gaps(channels.transpose(0, 2, 1) for channels in images)


def fills_rows(sensor: Sensor, trained: Sensor) -> bool:
    """Return whether a sensor has so many more gaps than training that they are filled."""
    if sensor.row_gaps is None or trained.row_gaps is None:
        return False
    return sensor.row_gaps > trained.row_gaps + MORE_GAPS


def with_filled_gaps(channels: Float, sensor: Sensor, trained: Sensor) -> Float:
    """Return channels with their gaps filled, if the sensor has many more than training.

    Parameters
    ----------
    channels : (5, H, W) float32
        Range image.
    sensor : Sensor
        Sensor of the image.
    trained : Sensor
        Sensor of the weights.

    Returns
    -------
    (5, H, W) float32
    """
    return fill_rows(channels) if fills_rows(sensor, trained) else channels


def fill_rows(channels: Float) -> Float:
    """Return channels (5, H, W) in which empty pixels hold the next point below."""
    filled = channels.copy()
    for rows in range(1, FILLED_ROWS + 1):
        upper = filled[:, :-rows]
        lower = channels[:, rows:]
        np.copyto(upper, lower, where=upper[0] <= 0)
    return filled
