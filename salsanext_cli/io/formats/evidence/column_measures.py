# SPDX-License-Identifier: MIT
"""Measures of how well values without a header fit a number of columns.

A column contains one kind of value, so the share of the variance that lies between columns is
largest for the right number and its multiples. Consecutive rows of a scanner have similar azimuths.
"""

import numpy as np

from salsanext_cli.core.records import Double, Float

COUNTS = range(3, 17)  # Numbers of columns that are distinguished
SAMPLE = 4096  # Rows that are examined, evenly spaced
BLOCKS = 32  # Parts of a file that are examined, evenly spaced
ROWS = 64  # Rows of each for their order
VALUES = 128  # Approximate values of each for their kinds
STEP_DEG = 5.0  # Largest difference in azimuth between consecutive measurements of a scanner
IN_TURN = 0.6
"""Least share of such points; real scans have 0.8 or more, wrong widths 0.34 or less."""
MIN_EXPLAINED = 0.05  # Least explained share of the variance for a decision
MIN_EXPLAINED_BY_CHANCE = 40  # What is added for few values: divided by their number
MIN_VARIANCE = 0.005  # Least variance of a property that is examined
RANGE_LOG10 = 3.0  # Magnitudes count up to a factor of a thousand


def explained_share(values: Float, columns: int) -> float:
    """Return the share of the variance of sign, wholeness and magnitude between the columns."""
    sample = blocks_of(values, columns, VALUES // columns).reshape(-1, columns)
    # Variances of a column are computed several times as fast if its values are consecutive.
    properties = properties_of(np.ascontiguousarray(sample.T))
    within = properties.var(axis=2, ddof=1).mean(axis=1)
    total = properties.var(axis=(1, 2))
    vary = total > MIN_VARIANCE
    return float(np.mean(1 - within[vary] / total[vary])) if vary.any() else 0.0


def properties_of(sample: Double | Float) -> Double:
    """Return sign, wholeness and magnitude of values (M, N), (3, M, N)."""
    with np.errstate(invalid="ignore"):  # of a signalling NaN
        size = np.where(np.isfinite(sample), np.abs(sample.astype(np.float64)), 1.0)
        is_whole = (size > 0) & (sample == np.rint(sample))
        magnitude = np.log10(np.maximum(size, 10**-RANGE_LOG10)) / RANGE_LOG10
        return np.stack([sample < 0, is_whole, np.minimum(magnitude, 1)])


def least_explained(values: Float, base: float = MIN_EXPLAINED) -> float:
    """Return the least explained share of values (M,) for a decision; few values explain more."""
    return base + MIN_EXPLAINED_BY_CHANCE / min(len(values), SAMPLE)


def are_in_turn(values: Float, columns: int) -> bool:
    """Return whether rows of `columns` values are points in the order of a scanner's turn."""
    return are_small(azimuth_steps(values, columns))


def are_small(steps: Double) -> bool:
    """Return whether most steps (M,) in azimuth are those of a scanner."""
    return int((steps < STEP_DEG).sum()) > IN_TURN * max(1, int(steps.size))


def azimuth_steps(values: Float, columns: int) -> Double:
    """Return the steps in azimuth between consecutive rows of `columns` values in degrees, (M,)."""
    # The few steps from one block to the next do not matter.
    steps: Double = np.abs((np.diff(azimuths_of(values, columns)) + 180) % 360 - 180)
    return steps


def azimuths_of(values: Float, columns: int) -> Double:
    """Return the azimuths of measured rows of `columns` values in degrees, (M,)."""
    x, y = np.moveaxis(blocks_of(values, columns), -1, 0)[:2]
    measured = np.isfinite(x) & np.isfinite(y) & ((x != 0) | (y != 0))
    azimuths: Double = np.degrees(np.arctan2(y[measured], x[measured]))
    return azimuths


def blocks_of(values: Float, columns: int, length: int = ROWS) -> Double:
    """Return evenly spaced blocks of rows, or all rows in one block.

    Parameters
    ----------
    values : (M,) float array
        Values of the file.
    columns : int
        Number of values of a row.
    length : int
        Number of rows of a block.

    Returns
    -------
    (BLOCKS, length, columns) float64
        Or (1, rows, columns) for few rows.
    """
    rows = values[: len(values) // columns * columns].reshape(-1, columns)[None]
    if rows.shape[1] > BLOCKS * length:
        starts = np.linspace(0, rows.shape[1] - length, BLOCKS).astype(np.intp)
        rows = rows[0, starts[:, None] + np.arange(length)]
    with np.errstate(invalid="ignore"):  # of a signalling NaN
        return rows.astype(np.float64)
