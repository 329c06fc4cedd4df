# SPDX-License-Identifier: MIT
"""Evidence that values without a header are stored column by column, in planes, not in rows."""

from collections.abc import Sequence

import numpy as np

from salsanext_cli.core.records import Float
from salsanext_cli.io.formats.evidence.column_evidence import (
    AXIS_COUNT,
    MOST_ROWS,
    SHARE_OF_LARGEST,
    USUAL_COUNT,
)
from salsanext_cli.io.formats.evidence.column_measures import (
    COUNTS,
    SAMPLE,
    are_in_turn,
    are_small,
    azimuth_steps,
    azimuths_of,
    explained_share,
    least_explained,
    properties_of,
)

PLANAR_COUNTS = range(3, 9)  # Numbers of columns that are distinguished
DIAGONAL_DEG = 45.0  # Apparent azimuth of neighbours in one column
DIAGONAL_WIDTH_DEG = 5.0  # Its deviation
MAX_DIAGONAL = 0.18
"""Its largest share in rows; real scans in turn had 0.12 or less, their columns 0.23 or more."""
WINDOW = 512  # Values on each side of a place where one column may end
SHARE_OF_MULTIPLES = 0.53
"""Least share of the variance that multiples explain; the right number had 0.61."""
SHARE_OF_OTHERS = 0.7
"""Least share of the variance that other numbers of planes explain; the right number had 0.81."""
SHARE_OF_JUMPS = 0.6
"""Least share of the changes between planes of other numbers; the right number had 0.94. Wrong
numbers had less in one of the three."""


def are_planes(values: Float, expected: int) -> bool | None:
    """Return whether values (M,), which are stored column by column, have `expected` columns.

    None stands for values in rows.
    """
    if len(values) < 2 * max(expected, max(COUNTS)):
        return None
    if expected == USUAL_COUNT and _are_rows_of_axes(values):
        return None
    counts = _plane_counts(values, expected)
    explained = _explained_by_planes(values, counts)
    most = max(explained.values(), default=0.0)
    if most < least_explained(values) or _explain_as_much(values, expected, most):
        return None
    if _are_padded_rows(values, expected):
        return None
    if expected not in counts:
        return False
    fits_both = expected == USUAL_COUNT and AXIS_COUNT in counts
    if fits_both and _planes_in_turn(values) == AXIS_COUNT:
        return False
    jumps = _jumps_of_planes(values, counts)
    # A multiple of the number divides each column into parts, which explain a little more.
    others = [count for count in counts if count % expected]
    most_of_others = max((explained[count] for count in others), default=0.0)
    jumps_of_others = max((jumps[count] for count in others), default=0.0)
    return (
        explained[expected] >= SHARE_OF_MULTIPLES * most
        and explained[expected] >= SHARE_OF_OTHERS * most_of_others
        and jumps[expected] >= SHARE_OF_JUMPS * jumps_of_others
    )


def _plane_counts(values: Float, expected: int) -> list[int]:
    """Return the numbers of planes of equal length that values can have."""
    return [count for count in sorted({expected, *PLANAR_COUNTS}) if len(values) % count == 0]


def _explained_by_planes(values: Float, counts: Sequence[int]) -> dict[int, float]:
    """Return the share of the variance between planes, by their number."""
    return {count: explained_share(_few_rows_of_planes(values, count), count) for count in counts}


def _explain_as_much(values: Float, expected: int, most: float) -> bool:
    """Return whether columns of rows explain about as much as the best number of planes."""
    # The expected number of columns in rows explains most of the usual files.
    shares = (explained_share(values, count) for count in [expected, *COUNTS])
    return any(share >= SHARE_OF_LARGEST * most for share in shares)


def _are_padded_rows(values: Float, expected: int) -> bool:
    """Return whether values are rows, among so many without a point that these look planar.

    The coordinates of such rows are zeros or not finite. They may be anywhere, as of arrays of a
    fixed size that a program filled from one end or in the middle.
    """
    rows = values[: len(values) // expected * expected].reshape(-1, expected)
    coordinates = rows[:, :AXIS_COUNT]
    with np.errstate(invalid="ignore"):  # of a signalling NaN
        is_empty = ~(np.isfinite(coordinates) & (coordinates != 0)).any(axis=1)
    measured = rows[~is_empty].ravel()
    if not is_empty.any() or len(measured) < 2 * max(expected, max(COUNTS)):
        return False
    counts = _plane_counts(measured, expected)
    most = max(_explained_by_planes(measured, counts).values(), default=0.0)
    return _explain_as_much(measured, expected, max(most, least_explained(measured)))


def _planes_in_turn(values: Float) -> int | None:
    """Return whether values are the planes of coordinates alone, or of the usual columns.

    The steps in azimuth are smaller for the right number. None stands for points in no order.
    """
    steps = {
        count: azimuth_steps(values.reshape(count, -1).T.ravel(), count)
        for count in (AXIS_COUNT, USUAL_COUNT)
    }
    if not any(map(are_small, steps.values())):
        return None
    largest = {
        count: float(np.quantile(angles, MOST_ROWS))
        for count, angles in steps.items()
        if len(angles)
    }
    return min(largest, key=largest.__getitem__)


def _jumps_of_planes(values: Float, counts: Sequence[int]) -> dict[int, float]:
    """Return how much the kind of the values changes between planes, by the number of planes."""
    places = {count: {len(values) * i // count for i in range(1, count)} for count in counts}
    all_places = {place for group in places.values() for place in group}
    jumps = {place: _jump(values, place) for place in all_places}
    return {count: sum(jumps[place] for place in places[count]) for count in counts}


def _jump(values: Float, place: int) -> float:
    """Return how much the mean properties of the values change at a place."""
    values_before = values[max(place - WINDOW, 0) : place, None]
    values_after = values[place : place + WINDOW, None]
    before = properties_of(values_before).mean(axis=(1, 2))
    after = properties_of(values_after).mean(axis=(1, 2))
    return float(np.square(after - before).sum())


def _few_rows_of_planes(values: Float, count: int) -> Float:
    """Return the values of evenly spaced rows of `count` planes, row by row."""
    planes = values.reshape(count, -1)
    chosen = np.linspace(0, planes.shape[1] - 1, min(SAMPLE, planes.shape[1])).astype(np.intp)
    return planes[:, chosen].T.ravel()


def _are_rows_of_axes(values: Float) -> bool:
    """Return whether values (M,) are rows of x, y, z in the order of a scanner's turn."""
    azimuth = azimuths_of(values, AXIS_COUNT)
    # Consecutive values of one column are nearly equal, which looks like an azimuth of 45°.
    diagonal = np.abs((azimuth - DIAGONAL_DEG + 90) % 180 - 90) < DIAGONAL_WIDTH_DEG
    is_column = diagonal.mean() > MAX_DIAGONAL if len(azimuth) else True
    return not is_column and are_in_turn(values, AXIS_COUNT)
