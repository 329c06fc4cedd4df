# SPDX-License-Identifier: MIT
"""Evidence of the number of columns of values without a header that are stored in rows."""

import numpy as np

from salsanext_cli.core.records import Double, Float, Mask
from salsanext_cli.io.formats.evidence.column_measures import (
    COUNTS,
    SAMPLE,
    are_in_turn,
    blocks_of,
    explained_share,
    least_explained,
)

AXIS_COUNT = 3  # Columns of coordinates alone
USUAL_COUNT = 4  # Number of columns with an intensity, instead of which coordinates are tried
MIN_SHARE_OF_SIGN = 0.1
"""Least share of the rarer sign of coordinates; they had 0.33 or more, intensities 0."""
MIN_EXPLAINED_BY_AXES = 0.02  # The same as `MIN_EXPLAINED` for coordinates alone
EMPTY_PERIODS = range(2, 5)  # Numbers of rows after which empty ones may recur
PERIODS_TOGETHER = 12  # Rows after which all of them recur
MIN_ROWS = 24  # Least number of rows that shows a recurrence
FEW_ROWS = 4  # The same of long rows
SHARE_OF_LARGEST = 0.6
"""Least share of the largest variance; the right number of columns has 0.97 or more."""
UNIT_TOLERANCE = 0.01  # Error in length of a normal
SAME_BEAM_RAD = 5e-4  # Angle between returns of one beam; adjacent beams are 1.5 mrad apart or more
MOVED_TOLERANCE_M = 0.005  # Error of a copy in another frame
MOST_ROWS = 0.9  # Share of rows that determines the columns of all


def evident_count(values: Float, expected: int) -> int | None:
    """Return a number of columns that values (M,) evidently have instead of `expected`, or None."""
    measured = _without_empty_rows(values, expected)
    if measured is not None and _evident_count(measured, expected) is None:
        return None
    return _evident_count(values, expected)


def _evident_count(values: Float, expected: int) -> int | None:
    if len(values) < 2 * max(expected, max(COUNTS)):
        return None
    count = expected
    if not are_in_turn(values, expected):
        explained = {n: explained_share(values, n) for n in {*COUNTS, expected}}
        most = max(explained.values())
        if most < least_explained(values):
            return AXIS_COUNT if _are_axes_alone(values, expected) else None
        if explained[expected] < SHARE_OF_LARGEST * most:
            # For beams in turn, explained variance grows with the number of rows taken as one.
            least = min(n for n in COUNTS if explained[n] >= SHARE_OF_LARGEST * most)
            count = next((n for n in COUNTS if are_in_turn(values, n)), least)
    count = _padded_count(values, count) or _least_count(values, count)
    return None if count == expected else count


def _are_axes_alone(values: Float, expected: int) -> bool:
    """Return whether values (M,) are rows of x, y, z where x, y, z, intensity are expected.

    The three are of similar kinds, so that they explain less than an intensity does.
    """
    if expected != USUAL_COUNT:
        return False
    if are_in_turn(values, AXIS_COUNT):
        return True
    explained = explained_share(values, AXIS_COUNT)
    least = least_explained(values, MIN_EXPLAINED_BY_AXES)
    return explained >= max(least, explained_share(values, expected) / SHARE_OF_LARGEST)


def have_signs_of_coordinates(values: Float, columns: int, place: int) -> bool:
    """Return whether the column at a place has the signs of coordinates, as all columns have.

    Then the columns are not those of the file: an intensity has one sign, and differs from
    coordinates. Values of coordinates that are stored column by column look so, in any order.

    Parameters
    ----------
    values : (M,) float array
        Values of the file.
    columns : int
        Supposed number of columns.
    place : int
        Place of the column among them.
    """
    if len(values) < SAMPLE:
        return False
    column = values[: len(values) // columns * columns].reshape(-1, columns)[:, place]
    negative = int((column < 0).sum())
    positive = int((column > 0).sum())
    if min(negative, positive) <= MIN_SHARE_OF_SIGN * (negative + positive):
        return False
    return explained_share(values, columns) < least_explained(values)


def empty_places(values: Float, columns: int) -> Mask | None:
    """Return which of consecutive rows, (period,) bool, are always empty; None if none are.

    Rows of `columns` values are empty if all are 0, or if the first three are not finite, such as
    second returns that were not measured.
    """
    if len(values) < MIN_ROWS * columns:
        return None
    sample = blocks_of(values, PERIODS_TOGETHER * columns, FEW_ROWS)
    if _empty_places_of(sample.reshape(-1, columns)) is None:
        return None
    return _empty_places_of(values[: len(values) // columns * columns].reshape(-1, columns))


def _empty_places_of(rows: Float | Double) -> Mask | None:
    with np.errstate(invalid="ignore"):  # of a signalling NaN
        empty = ~(rows != 0).any(axis=1) | ~np.isfinite(rows[:, :3]).any(axis=1)
    for period in EMPTY_PERIODS:
        places: Mask = empty[: len(rows) // period * period].reshape(-1, period).all(axis=0)
        if places.any() and not places.all():
            return places
    return None


def _without_empty_rows(values: Float, columns: int) -> Float | None:
    """Return values without the rows at the places that are always empty; None without such."""
    places = empty_places(values, columns)
    if places is None:
        return None
    size = len(places) * columns
    records = values[: len(values) // size * size].reshape(-1, len(places), columns)
    return records[:, ~places].ravel()


def _least_count(values: Float, count: int) -> int:
    """Return the number of columns of one point, if `count` is a multiple of it."""
    for least in COUNTS:
        if least >= count or count % least:
            continue
        points = blocks_of(values, count).reshape(-1, count // least, least)
        measured = points[..., :2].any(axis=2).mean(axis=0)
        in_turn = measured.min() > measured.max() / 2 and are_in_turn(values, least)
        share = explained_share(values, least)
        alike = in_turn or share > SHARE_OF_LARGEST * explained_share(values, count)
        if alike and _are_of_two_points(points[:, 0, :3], points[:, 1, :3]):
            return least
    return count


def _are_of_two_points(first: Double, second: Double) -> bool:
    """Return whether values (N, 3) and the next ones of their rows are two points of a scan.

    They are not if the second ones are normals, returns of the same beams, or moved copies.
    """
    is_measured = _are_measured(first) & _are_measured(second)
    first = first[is_measured]
    second = second[is_measured]
    size = np.linalg.norm(second, axis=1)
    across = np.linalg.norm(np.cross(first, second), axis=1)
    is_normal = np.abs(size - 1) < UNIT_TOLERANCE
    is_same_beam = across <= SAME_BEAM_RAD * size * np.linalg.norm(first, axis=1)
    homogeneous = np.column_stack([first, np.ones(len(first))])
    moved = homogeneous @ np.linalg.lstsq(homogeneous, second, rcond=None)[0]
    is_moved = (np.abs(second - moved) < MOVED_TOLERANCE_M).all(axis=1)
    most = MOST_ROWS * len(second)
    return all(mask.sum() < most for mask in (is_normal, is_same_beam, is_moved))


def _are_measured(points: Double) -> Mask:
    """Return which points (N, 3) are finite and not at the origin."""
    is_finite: Mask = np.isfinite(points)
    is_measured: Mask = np.logical_and(is_finite.all(axis=1), points.any(axis=1))
    return is_measured


def _padded_count(values: Float, columns: int) -> int | None:
    """Return the number of columns of a table with only zeros after the expected ones, or None."""
    for count in reversed(range(2 * columns, COUNTS.stop, columns)):
        sample = blocks_of(values, count)
        if not sample[..., columns:].any() and sample.any():
            return count
    return None
