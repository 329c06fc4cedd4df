# SPDX-License-Identifier: MIT
"""Evidence of the type of values without a header: float32, float64, float16, or no coordinates."""

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.records import Float, Mask
from salsanext_cli.io.formats.evidence.column_measures import (
    COUNTS,
    SAMPLE,
    explained_share,
    least_explained,
)

LEAST_MAGNITUDE = 1e-12  # Least possible one of a value other than 0, in any unit
LARGEST_MAGNITUDE = 1e7  # Largest possible one, in metres and in any unit of intensity and time
MIN_POSSIBLE_SHARE = 0.5  # Share of coordinates possible in any scan; random bytes have a quarter
MIN_POSSIBLE_SHARE_OF_LOW = 0.42
"""The same of every second value, if they are float32; of a planar scanner, half of them are z = 0.
"""
MIN_POSSIBLE_SHARE_OF_FLOAT64 = 0.9
SCAN_RANGES_M = (0.3, 250.0)  # Possible median ranges of a scan
PAIR_BLOCKS = 8  # Blocks of a file that show whether its values are float64
BLOCK_PAIRS = 512  # Pairs of values in each


def are_float64(values: Float) -> bool:
    """Return whether float32 values (M,) of a file are the halves of float64 ones."""
    if len(values) % 2:
        return False
    pairs = values.reshape(-1, 2)
    blocks = blocks_of_pairs(len(pairs))
    return are_halves(np.concatenate([pairs[block.start : block.stop] for block in blocks]))


def blocks_of_pairs(count: int) -> list[range]:
    """Return evenly spaced blocks of `count` pairs that show whether all are halves of float64."""
    if count <= PAIR_BLOCKS * BLOCK_PAIRS:
        return [range(count)]
    starts = np.linspace(0, count - BLOCK_PAIRS, PAIR_BLOCKS).astype(np.intp)
    return [range(start, start + BLOCK_PAIRS) for start in starts.tolist()]


def are_halves(pairs: Float) -> bool:
    """Return whether pairs (M, 2) of float32 values are the halves of float64 ones."""
    # Most pairs are then possible as float64, and most low halves are impossible as float32. Those
    # of rounded decimals are random bits; those of former float32 values have one of eight values,
    # six of which are impossible.
    halves = np.ascontiguousarray(pairs)
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
    if len(halves) % columns or len(halves) < 2 * max(columns, max(COUNTS)):
        return False
    rows = _sample(halves.reshape(-1, columns)).astype(np.float32)
    rows_of_float32 = _sample(values[: len(values) // columns * columns].reshape(-1, columns))
    if not _has_scan_ranges(rows) or _has_scan_ranges(rows_of_float32):
        return False
    is_finite = bool(np.isfinite(rows).all())
    is_varied = bool((rows[:, :3] != 0).mean(axis=0).min() > MIN_POSSIBLE_SHARE)
    if not (is_finite and is_varied):
        return False
    return explained_share(halves, columns) > least_explained(halves)


def _has_scan_ranges(rows: Float) -> bool:
    """Return whether points (N, 3 or more) have the median range of a scan; NaN counts as far."""
    with np.errstate(over="ignore", invalid="ignore"):
        ranges = np.linalg.norm(rows[:, :3].astype(np.float64), axis=1)
    least, most = SCAN_RANGES_M
    return least < float(np.median(np.nan_to_num(ranges, nan=np.inf))) < most


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
        return (magnitudes > LEAST_MAGNITUDE) & (magnitudes < LARGEST_MAGNITUDE)
