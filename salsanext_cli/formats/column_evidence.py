# SPDX-License-Identifier: MIT
"""Evidence of the layout of values without a header: type, number of columns, order.

The right number of columns is evident from the values: a column contains one kind of value, so the
share of the variance that lies between columns is largest for the right number and its multiples.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from salsanext_cli.records import Double, Float, Mask

LEAST, MOST = 1e-12, 1e7
"""Possible magnitudes of values other than 0, in metres and in any unit of intensity and time."""
MIN_POSSIBLE_SHARE = 0.5  # Share of coordinates possible in any scan; random bytes have a quarter
MIN_POSSIBLE_SHARE_OF_LOW = 0.42
"""The same of every second float32; half of those of a planar scanner, z, are 0."""
MIN_POSSIBLE_SHARE_OF_FLOAT64 = 0.9
SCAN_RANGES_M = (0.3, 250.0)  # Possible median ranges of a scan
SAMPLE = 4096  # Rows that are examined, evenly spaced


def are_float64(values: Float) -> bool:
    """Return whether float32 values (M,) of a file are the halves of float64 ones."""
    # Then most are possible as float64, and most low halves are impossible as float32: random bits
    # for rounded decimals; for former float32 one of eight values, six of which are impossible.
    if len(values) % 2:
        return False
    halves = np.ascontiguousarray(_sample(values.reshape(-1, 2)))
    # Values that were not measured, 0 or NaN, show nothing.
    doubles = halves.view("<f8").ravel()
    halves = halves[np.isfinite(doubles) & (doubles != 0)]
    if not len(halves):
        return False
    possible = are_possible(halves.view("<f8")).mean() > MIN_POSSIBLE_SHARE_OF_FLOAT64
    return bool(possible and are_possible(halves[:, 0]).mean() < MIN_POSSIBLE_SHARE_OF_LOW)


def are_float16(values: Float, columns: int) -> bool:
    """Return whether float32 values (M,) of a file are pairs of float16 in rows of `columns`."""
    halves = np.ascontiguousarray(values).view("<f2")
    if len(halves) % columns or len(halves) < 2 * max(columns, *COUNTS):
        return False
    rows = _sample(halves.reshape(-1, columns)).astype(np.float32)
    finite = bool(np.isfinite(rows).all())
    varied = bool((rows[:, :3] != 0).mean(axis=0).min() > MIN_POSSIBLE_SHARE)
    as_float32 = _median_range(
        _sample(values[: len(values) // columns * columns].reshape(-1, columns))
    )
    least, most = SCAN_RANGES_M
    if not (finite and varied and least < _median_range(rows) < most) or least < as_float32 < most:
        return False
    return _explained(halves, columns) > MIN_EXPLAINED + MIN_EXPLAINED_BY_CHANCE / SAMPLE


def _median_range(rows: Float) -> float:
    """Return the median distance of points (N, 3 or more) from the origin; NaN counts as far."""
    with np.errstate(over="ignore", invalid="ignore"):
        ranges = np.linalg.norm(rows[:, :3].astype(np.float64), axis=1)
    return float(np.median(np.nan_to_num(ranges, nan=np.inf)))


def are_coordinates(values: Float) -> bool:
    """Return whether coordinates (N, 3) float32 can be metres, points at 0, NaN, inf aside."""
    rows = _sample(values)
    measured = rows[np.isfinite(rows) & (rows != 0)]
    return int(are_possible(measured).sum()) >= MIN_POSSIBLE_SHARE * len(measured)


def _sample(rows: Float) -> Float:
    return rows[:: len(rows) // SAMPLE | 1]  # An odd step meets all columns.


def are_possible(values: npt.NDArray[np.floating]) -> Mask:
    """Mark the magnitudes of measurements; 0 and NaN are none."""
    with np.errstate(invalid="ignore"):  # of a signalling NaN
        magnitudes = np.abs(values)
        return (magnitudes > LEAST) & (magnitudes < MOST)


COUNTS = range(3, 17)  # Numbers of columns that are distinguished
PLANAR_COUNTS = range(3, 9)  # The same of files that are stored column by column
AXIS_COUNT = 3  # Columns of coordinates alone
USUAL_COUNT = 4  # Number of columns with an intensity, instead of which coordinates are tried
DIAGONAL_DEG, DIAGONAL_WIDTH_DEG, MAX_DIAGONAL = 45.0, 5.0, 0.18
"""Apparent azimuth of neighbours in one column, its deviation, and its largest share in rows; real
scans in turn had 0.12 or less, their columns 0.23 or more."""
MIN_EXPLAINED_BY_AXES = 0.02  # The same as `MIN_EXPLAINED` for coordinates alone
WINDOW = 512  # Values on each side of a place where one column may end
SHARE_OF_MULTIPLES, SHARE_OF_OTHERS, SHARE_OF_JUMPS = 0.53, 0.7, 0.6
"""Least shares of the variance that multiples and other numbers of planes explain, and of the
changes between planes; the right number had 0.61, 0.81 and 0.94, wrong ones less in one of them."""
EMPTY_PERIODS = range(2, 5)  # Numbers of rows after which empty ones may recur
PERIODS_TOGETHER = 12  # Rows after which all of them recur
MIN_ROWS = 24  # Least number of rows that shows a recurrence
BLOCKS = 32  # Parts of a file that are examined, evenly spaced
ROWS, VALUES = 64, 128  # Rows of each for their order, and approximate values for their kinds
FEW_ROWS = 4  # The same of long rows
STEP_DEG = 5.0  # Largest difference in azimuth between consecutive measurements of a scanner
IN_TURN = 0.6
"""Least share of such points; real scans have 0.8 or more, wrong widths 0.34 or less."""
SHARE_OF_LARGEST = 0.6
"""Least share of the largest variance; the right number of columns has 0.97 or more."""
MIN_EXPLAINED, MIN_EXPLAINED_BY_CHANCE = 0.05, 40
"""Least explained variance for a decision; the second is divided by the number of values."""
MIN_VARIANCE = 0.005  # Least variance of a property that is examined
UNIT_TOLERANCE = 0.01  # Error in length of a normal
SAME_BEAM_RAD = 5e-4  # Angle between returns of one beam; adjacent beams are 1.5 mrad apart or more
MOVED_TOLERANCE_M = 0.005  # Error of a copy in another frame
MOST_ROWS = 0.9  # Share of rows that determines the columns of all
RANGE_LOG10 = 3.0  # Magnitudes count up to a factor of a thousand


def evident_count(values: Float, expected: int) -> int | None:
    """Return a number of columns that values (M,) evidently have instead of `expected`, or None."""
    measured = _without_empty_rows(values, expected)
    if measured is not None and _evident_count(measured, expected) is None:
        return None
    return _evident_count(values, expected)


def _evident_count(values: Float, expected: int) -> int | None:
    if len(values) < 2 * max(expected, *COUNTS):
        return None
    count = expected
    if not _are_in_turn(values, expected):
        explained = {n: _explained(values, n) for n in {*COUNTS, expected}}
        most = max(explained.values())
        if most < MIN_EXPLAINED + MIN_EXPLAINED_BY_CHANCE / min(len(values), SAMPLE):
            return AXIS_COUNT if _are_axes_alone(values, expected) else None
        if explained[expected] < SHARE_OF_LARGEST * most:
            # For beams in turn, explained variance grows with the number of rows taken as one.
            in_turn = (n for n in COUNTS if _are_in_turn(values, n))
            least = min(n for n in COUNTS if explained[n] >= SHARE_OF_LARGEST * most)
            count = next(in_turn, least)
    count = _padded_count(values, count) or _least_count(values, count)
    return None if count == expected else count


def _are_axes_alone(values: Float, expected: int) -> bool:
    """Return whether values (M,) are rows of x, y, z where x, y, z, intensity are expected.

    The three are of similar kinds, so that they explain less than an intensity does.
    """
    if expected != USUAL_COUNT:
        return False
    if _are_in_turn(values, AXIS_COUNT):
        return True
    least = MIN_EXPLAINED_BY_AXES + MIN_EXPLAINED_BY_CHANCE / min(len(values), SAMPLE)
    explained = _explained(values, AXIS_COUNT)
    return explained >= max(least, _explained(values, expected) / SHARE_OF_LARGEST)


def empty_places(values: Float, columns: int) -> Mask | None:
    """Return which of consecutive rows, (period,) bool, are always empty; None if none are.

    Rows of `columns` values are empty if all are 0, or if the first three are not finite, such as
    second returns that were not measured.
    """
    if len(values) < MIN_ROWS * columns:
        return None
    sample = _rows(values, PERIODS_TOGETHER * columns, FEW_ROWS)
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


def are_planes(values: Float, expected: int) -> bool | None:
    """Return whether values (M,), which are stored column by column, have `expected` columns.

    None stands for values in rows.
    """
    if len(values) < 2 * max(expected, *COUNTS):
        return None
    counts = [n for n in sorted({expected, *PLANAR_COUNTS}) if len(values) % n == 0]
    explained = {n: _explained(_few_rows_of_planes(values, n), n) for n in counts}
    most = max(explained.values(), default=0.0)
    chance = MIN_EXPLAINED + MIN_EXPLAINED_BY_CHANCE / min(len(values), SAMPLE)
    if expected == USUAL_COUNT and _are_rows_of_axes(values):
        return None
    # The expected number of columns in rows explains most of the usual files.
    by_rows = (_explained(values, count) for count in (expected, *COUNTS))
    if most < chance or any(share >= SHARE_OF_LARGEST * most for share in by_rows):
        return None
    jumps = _jumps_of_planes(values, counts)
    fits_both = expected == USUAL_COUNT and {expected, AXIS_COUNT} <= {*counts}
    if fits_both and _planes_in_turn(values) == AXIS_COUNT:
        return False
    # A multiple of the number divides each column into parts, which explain a little more.
    others = [count for count in counts if count % expected]
    return expected in counts and (
        explained[expected] >= SHARE_OF_MULTIPLES * most
        and explained[expected] >= SHARE_OF_OTHERS * max((explained[n] for n in others), default=0)
        and jumps[expected] >= SHARE_OF_JUMPS * max((jumps[n] for n in others), default=0)
    )


def _planes_in_turn(values: Float) -> int | None:
    """Return whether values are the planes of coordinates alone, or of the usual columns.

    The steps in azimuth are smaller for the right number. None stands for points in no order.
    """
    steps = {
        count: _steps(values.reshape(count, -1).T.ravel(), count)
        for count in (AXIS_COUNT, USUAL_COUNT)
    }
    if not any(map(_are_small, steps.values())):
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
    jumps = {place: _jump(values, place) for place in set().union(*places.values())}
    return {count: sum(map(jumps.__getitem__, places[count])) for count in counts}


def _jump(values: Float, place: int) -> float:
    """Return how much the mean properties of the values change at a place."""
    nearby = values[max(place - WINDOW, 0) : place], values[place : place + WINDOW]
    before, after = (_properties(part[:, None]).mean(axis=(1, 2)) for part in nearby)
    return float(np.square(after - before).sum())


def _few_rows_of_planes(values: Float, count: int) -> Float:
    """Return the values of evenly spaced rows of `count` planes, row by row."""
    planes = values.reshape(count, -1)
    chosen = np.linspace(0, planes.shape[1] - 1, min(SAMPLE, planes.shape[1])).astype(np.intp)
    return planes[:, chosen].T.ravel()


def _rows(values: Float, columns: int, length: int = ROWS) -> Double:
    """Return evenly spaced blocks of rows, (BLOCKS, length, columns), or all rows in one block."""
    rows = values[: len(values) // columns * columns].reshape(-1, columns)[None]
    if rows.shape[1] > BLOCKS * length:
        starts = np.linspace(0, rows.shape[1] - length, BLOCKS).astype(np.intp)
        rows = rows[0, starts[:, None] + np.arange(length)]
    with np.errstate(invalid="ignore"):  # of a signalling NaN
        return rows.astype(np.float64)


def _are_in_turn(values: Float, columns: int) -> bool:
    """Return whether rows of `columns` values are points in the order of a scanner's turn."""
    return _are_small(_steps(values, columns))


def _are_small(steps: Double) -> bool:
    """Return whether most steps (M,) in azimuth are those of a scanner."""
    return int((steps < STEP_DEG).sum()) > IN_TURN * max(1, int(steps.size))


def _are_rows_of_axes(values: Float) -> bool:
    """Return whether values (M,) are rows of x, y, z in the order of a scanner's turn."""
    azimuth = _azimuths(values, AXIS_COUNT)
    # Consecutive values of one column are nearly equal, which looks like an azimuth of 45°.
    diagonal = np.abs((azimuth - DIAGONAL_DEG + 90) % 180 - 90) < DIAGONAL_WIDTH_DEG
    is_column = diagonal.mean() > MAX_DIAGONAL if len(azimuth) else True
    return not is_column and _are_in_turn(values, AXIS_COUNT)


def _steps(values: Float, columns: int) -> Double:
    """Return the steps in azimuth between consecutive rows of `columns` values in degrees, (M,)."""
    # The few steps from one block to the next do not matter.
    steps: Double = np.abs((np.diff(_azimuths(values, columns)) + 180) % 360 - 180)
    return steps


def _azimuths(values: Float, columns: int) -> Double:
    """Return the azimuths of measured rows of `columns` values in degrees, (M,)."""
    x, y = np.moveaxis(_rows(values, columns), -1, 0)[:2]
    measured = np.isfinite(x) & np.isfinite(y) & ((x != 0) | (y != 0))
    azimuths: Double = np.degrees(np.arctan2(y[measured], x[measured]))
    return azimuths


def _least_count(values: Float, count: int) -> int:
    """Return the number of columns of one point, if `count` is a multiple of it."""
    for least in (n for n in COUNTS if n < count and count % n == 0):
        points = _rows(values, count).reshape(-1, count // least, least)
        measured = points[..., :2].any(axis=2).mean(axis=0)
        in_turn = measured.min() > measured.max() / 2 and _are_in_turn(values, least)
        alike = in_turn or _explained(values, least) > SHARE_OF_LARGEST * _explained(values, count)
        if alike and _are_of_two_points(*points[:, :2, :3].swapaxes(0, 1)):
            return least
    return count


def _are_of_two_points(first: Double, second: Double) -> bool:
    """Return whether values (N, 3) and the next ones of their rows are two points of a scan.

    They are not if the second ones are normals, returns of the same beams, or moved copies.
    """
    both = np.stack([first, second])
    both = both[:, (np.isfinite(both).all(axis=2) & both.any(axis=2)).all(axis=0)]
    first, second = both
    size = np.linalg.norm(second, axis=1)
    across = np.linalg.norm(np.cross(first, second), axis=1)
    is_normal = np.abs(size - 1) < UNIT_TOLERANCE
    is_same_beam = across <= SAME_BEAM_RAD * size * np.linalg.norm(first, axis=1)
    known = np.column_stack([first, np.ones(len(first))])
    moved = known @ np.linalg.lstsq(known, second, rcond=None)[0]
    is_moved = (np.abs(second - moved) < MOVED_TOLERANCE_M).all(axis=1)
    most = MOST_ROWS * len(second)
    return all(mask.sum() < most for mask in (is_normal, is_same_beam, is_moved))


def _padded_count(values: Float, columns: int) -> int | None:
    """Return the number of columns of a table with only zeros after the expected ones, or None."""
    for count in reversed(range(2 * columns, COUNTS.stop, columns)):
        sample = _rows(values, count)
        if not sample[..., columns:].any() and sample.any():
            return count
    return None


def _explained(values: Float, columns: int) -> float:
    """Return the share of the variance of sign, wholeness and magnitude between the columns."""
    sample = _rows(values, columns, VALUES // columns).reshape(-1, columns)
    properties = _properties(sample)
    within, total = properties.var(axis=1, ddof=1).mean(axis=1), properties.var(axis=(1, 2))
    vary = total > MIN_VARIANCE
    return float(np.mean(1 - within[vary] / total[vary])) if vary.any() else 0.0


def _properties(sample: Double | Float) -> Double:
    """Return sign, wholeness and magnitude of values (N, C), (3, N, C)."""
    with np.errstate(invalid="ignore"):  # of a signalling NaN
        size = np.where(np.isfinite(sample), np.abs(sample.astype(np.float64)), 1.0)
        is_whole = (size > 0) & (sample == np.rint(sample))
        magnitude = np.log10(np.maximum(size, 10**-RANGE_LOG10)) / RANGE_LOG10
        return np.stack([sample < 0, is_whole, np.minimum(magnitude, 1)])
