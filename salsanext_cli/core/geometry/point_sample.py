# SPDX-License-Identifier: MIT
"""Ranges of points, and random samples of the points of a scan."""

import sys
from functools import cache

import numpy as np

from salsanext_cli.core.records import Double, Float, Indices, Mask, Scan

MAX_POINTS = 4096  # Points in a sample of a scan


def measured_ranges(points: Float, farthest: float = sys.float_info.max) -> tuple[Double, Mask]:
    """Return the ranges of points, and which of them are measurements.

    Parameters
    ----------
    points : (N, 3) float32
        Coordinates in metres.
    farthest : float
        Largest range of a measurement in metres.

    Returns
    -------
    ranges : (N,) float64
        Distances from the origin in metres.
    is_measured : (N,) bool
        Whether a range is finite, above 0 and not beyond the farthest.
    """
    with np.errstate(invalid="ignore"):  # A signalling NaN
        x, y, z = np.square(points.T, dtype=np.float64)
        ranges = np.sqrt(x + y + z)
    return ranges, (ranges > 0) & (ranges <= farthest)


def few_points(scan: Scan, count: int = MAX_POINTS) -> Scan:
    """Return a random sample of `count` points of a scan in their order, or all."""
    return scan if len(scan) <= count else scan.take(sample_places(len(scan), count))


def sample_places(length: int, count: int) -> Indices:
    """Return a random sample of indices below a length in rising order, the same in every run."""
    # Every n-th point of a grid could be of few beams or directions.
    return np.arange(length) if length <= count else (sample_shares(count) * length).astype(np.intp)


@cache
def sample_shares(count: int) -> Double:
    """Return the places of a random sample as shares of the length, rising: (count,) float64."""
    return np.sort(np.random.default_rng(0).random(count))
