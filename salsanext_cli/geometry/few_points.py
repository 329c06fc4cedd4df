# SPDX-License-Identifier: MIT
"""A sample of the points of a scan, enough to find its ground and to check it."""

import numpy as np

from salsanext_cli.records import Scan

MAX_POINTS = 4096


def few_points(scan: Scan, count: int = MAX_POINTS) -> Scan:
    """Return a number of points of a scan in their order, drawn alike; all if there are no more.

    Of points in the order of a grid, every n-th could be of few beams or in few directions.
    """
    if len(scan) <= count:
        return scan
    drawn = np.sort(np.random.default_rng(0).integers(0, len(scan), count))
    return Scan(scan.points[drawn], scan.intensity[drawn])
