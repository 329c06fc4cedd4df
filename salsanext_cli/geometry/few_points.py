# SPDX-License-Identifier: MIT
"""A sample of the points of a scan, enough to find its ground and to check it."""

from functools import cache

import numpy as np
import numpy.typing as npt

from salsanext_cli.records import Scan

MAX_POINTS = 4096


def few_points(scan: Scan, count: int = MAX_POINTS) -> Scan:
    """Return a number of points of a scan in their order, drawn alike; all if there are no more.

    Of points in the order of a grid, every n-th could be of few beams or in few directions.
    """
    if len(scan) <= count:
        return scan
    places = drawn(len(scan), count)
    return Scan(scan.points[places], scan.intensity[places])


def drawn(length: int, count: int) -> npt.NDArray[np.intp]:
    """Return places in an array of a length, rising, drawn alike; all if there are no more.

    Returns (count,) or (length,) intp.
    """
    return np.arange(length) if length <= count else (_uniform(count) * length).astype(np.intp)


@cache
def _uniform(count: int) -> npt.NDArray[np.float64]:
    return np.sort(np.random.default_rng(0).random(count))
