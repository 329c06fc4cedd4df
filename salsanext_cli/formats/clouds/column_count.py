# SPDX-License-Identifier: MIT
"""Number of columns of a table of float32 without header, from the statistics of its values.

Values that are a row apart are of one kind: coordinates, intensities, beams. So the share of the
variance that lies between the columns of a table is largest for the right number of columns and its
multiples; read with another number, every column holds a mixture.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from salsanext_cli.formats.clouds.raw_records import are_possible
from salsanext_cli.records import Float
from salsanext_cli.sensors.limits import UNUSED_COLUMN

COUNTS = range(3, 17)
"""Numbers of columns that are told apart."""
BLOCKS = 32
"""Places of a file that are looked at, evenly spaced."""
ROWS = 64
"""Rows of each that are looked at for their order."""
VALUES = 128
"""Values of each that are looked at for their kinds."""
STEP_DEG = 5.0
"""Largest difference in azimuth between points that a scanner measured in turn."""
IN_TURN = 0.6
"""Least share of such points that shows the rows to be points; in real scans it is 0.8 or more, in
tables read with another number of columns 0.34 or less."""
SHARE_OF_LARGEST = 0.6
"""Share of the largest explained variance at which a number of columns is a possible one: in real
scans the right one has 0.97 or more, in tables of others 4 has 0.4 or less."""
LEAST_EXPLAINED, LEAST_EXPLAINED_BY_CHANCE = 0.05, 40
"""Explained variance below which nothing is said; the second is by the number of values."""
LEAST_VARIANCE = 0.005
"""Variance of a property below which it is not looked at."""
RANGE_LOG10 = 3.0
"""Magnitudes count up to a factor of a thousand."""


def evident_count(values: Float, expected: int) -> int | None:
    """Return another number of columns that a table evidently has, None if there is none.

    `values` (M,) float32, all values of the table, row by row; a part of the last row may be
    missing; `expected`: number of columns that its reader expects.
    """
    if len(values) < LEAST_EXPLAINED_BY_CHANCE:
        return None
    if _are_in_turn(values, expected):
        return _padded_count(values, expected)
    places, properties = _properties(values)
    explained = {n: _explained(places, properties, n) for n in {*COUNTS, expected}}
    most = max(explained.values())
    if most < LEAST_EXPLAINED + LEAST_EXPLAINED_BY_CHANCE / len(places):
        return None
    if explained[expected] >= SHARE_OF_LARGEST * most:
        return None
    # Of beams in turn, explained variance grows with the number of rows taken for one.
    in_turn = (n for n in COUNTS if _are_in_turn(values, n))
    count = next(in_turn, min(n for n in COUNTS if explained[n] >= SHARE_OF_LARGEST * most))
    return _padded_count(values, count) or count


def likely_names(table: Float) -> tuple[str, ...] | None:
    """Return names to try for the columns of a table (N, C) float32, None if some are no float32.

    The intensity is the first column after the coordinates that varies and is never negative. Of
    five columns, one of whole numbers beside it tells the beam.
    """
    rows = table[:: max(1, len(table) // (BLOCKS * VALUES))]
    for column in rows.T:
        values = column[np.isfinite(column) & (column != 0)]
        if np.count_nonzero(are_possible(values)) < len(values) / 2:
            return None
    others = [_Kind.of(column) for column in rows.T[3:]]
    if [kind.is_whole for kind in others] == [True, False] and others[1].may_be_intensity:
        return ("x", "y", "z", "ring", "intensity")
    names = [UNUSED_COLUMN] * len(others)
    first = next((i for i, kind in enumerate(others) if kind.may_be_intensity), None)
    if first is not None:
        names[first] = "intensity"
    if names == ["intensity", UNUSED_COLUMN] and others[1].is_whole:
        names[1] = "ring"
    return ("x", "y", "z", *names)


class _Kind(NamedTuple):
    """Values that a column may hold."""

    may_be_intensity: bool
    is_whole: bool

    @classmethod
    def of(cls, column: Float) -> _Kind:
        varies = bool((column != column[0]).any())
        is_whole = varies and bool((column == np.rint(column)).all())
        return cls(varies and not (column < 0).any(), is_whole)


def _places(count: int, length: int) -> npt.NDArray[np.intp]:
    """Return evenly spaced blocks of the indices of so many items, (BLOCKS, length or less)."""
    length = min(length, count)
    starts = np.linspace(0, count - length, BLOCKS).astype(np.intp)
    return starts[:, None] + np.arange(length)


def _are_in_turn(values: Float, columns: int) -> bool:
    """Say whether rows of so many values are points in the order of a scanner's turn.

    Rows without a measurement are left out.
    """
    rows = values[: len(values) // columns * columns].reshape(-1, columns)
    # A NaN may signal.
    with np.errstate(invalid="ignore"):
        x, y = (rows[:, axis][_places(len(rows), ROWS)].astype(np.float64) for axis in (0, 1))
        azimuth = np.degrees(np.arctan2(y, x))
        measured = np.isfinite(azimuth) & ((x != 0) | (y != 0))
        # What follows from one block to the next is little.
        steps = np.abs((np.diff(azimuth[measured]) + 180) % 360 - 180)
    return int((steps < STEP_DEG).sum()) > IN_TURN * max(1, int(steps.size))


def _padded_count(values: Float, columns: int) -> int | None:
    """Return the number of columns of a table that has only zeros beside the columns expected."""
    for count in reversed(range(2 * columns, COUNTS.stop, columns)):
        rows = values[: len(values) // count * count].reshape(-1, count)
        # A NaN may signal.
        with np.errstate(invalid="ignore"):
            sample = rows[_places(len(rows), ROWS)].astype(bool)
        if not sample[..., columns:].any() and sample.any():
            return count
    return None


def _properties(values: Float) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.float64]]:
    """Return the places (K,) of a sample of values, and their properties (5, K)."""
    places = np.unique(_places(len(values), VALUES))
    with np.errstate(invalid="ignore"):
        sample = values[places].astype(np.float64)
    size = np.abs(sample)
    finite = np.isfinite(size)
    measured = np.where(finite & (size > 0), size, 1.0)
    kinds = (sample < 0, sample == 0, finite & (sample != 0) & (sample == np.rint(sample)), ~finite)
    magnitude = np.where(size > 0, np.clip(np.log10(measured) / RANGE_LOG10, -1, 1), -1)
    return places, np.stack([*kinds, magnitude]).astype(np.float64)


def _explained(
    places: npt.NDArray[np.intp], properties: npt.NDArray[np.float64], columns: int
) -> float:
    """Return the mean share of the properties' variance that lies between columns (adjusted R²)."""
    index, count = places % columns, len(places)
    sizes = np.maximum(np.bincount(index, minlength=columns), 1)
    shares = []
    for values in properties:
        total = values.var()
        if total > LEAST_VARIANCE:
            means = np.bincount(index, values, columns) / sizes
            between = float(sizes @ (means - values.mean()) ** 2) / count
            unexplained = max(0.0, 1 - between / total)
            shares.append(1 - unexplained * (count - 1) / max(1, count - columns))
    return float(np.mean(shares)) if shares else 0.0
