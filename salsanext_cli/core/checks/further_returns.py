# SPDX-License-Identifier: MIT
"""Further returns of one pulse, which lie behind its first one in the same direction.

Files contain the returns of a pulse one after the other, after one firing of all beams, or after
the first returns of the whole scan.
"""

import numpy as np

from salsanext_cli.core.records import Double, Float, Indices, Mask

STEPS = (1, 16, 32, 64, 128)
"""Points of the file from one return of a pulse to the next: adjacent, or after so many beams."""
HALVES = 2  # Parts of a file of which each has one return of every pulse
MIN_GAP_M = 0.3  # Least distance between the ranges of two returns of a pulse
MAX_OFFSET_M = 0.3
"""Largest distance of a beam from the origin. Lasers are up to 0.2 m from that of their sensor; of
the hidden points of several scans in one, a fifteenth follows such a beam by chance."""


def count_further_returns(points: Float, origin: Double, hidden: Indices) -> int:
    """Return how many hidden points are further returns of a pulse.

    Parameters
    ----------
    points : (N, 3) float32
        Points of a scan in the order of its file, in metres.
    origin : (3,) float64
        Position of the sensor in the frame of the points, in metres.
    hidden : (M,) intp
        Indices of points behind others.

    Returns
    -------
    int
        Number for the order of the returns that explains most of them.
    """
    steps = (*STEPS, len(points) // HALVES)
    return max(int(_are_further_returns(points, origin, hidden, step).sum()) for step in steps)


def _are_further_returns(points: Float, origin: Double, hidden: Indices, step: int) -> Mask:
    """Return which hidden points (M,) have a nearer return `step` places before or after them."""
    is_further = np.zeros(len(hidden), np.bool_)
    for places in (hidden - step, hidden + step):
        inside = (places >= 0) & (places < len(points))
        nearer = points[places[inside]] - origin
        farther = points[hidden[inside]] - origin
        is_further[inside] |= _are_of_one_pulse(nearer, farther)
    return is_further


def _are_of_one_pulse(nearer: Double, farther: Double) -> Mask:
    """Return whether two points (M, 3) lie on one beam, the first of them nearer to the sensor."""
    gap = np.linalg.norm(farther, axis=1) - np.linalg.norm(nearer, axis=1)
    length = np.linalg.norm(farther - nearer, axis=1)
    area = np.linalg.norm(np.cross(nearer, farther), axis=1)
    # The distance of a line through two points from the origin is twice their triangle by its base.
    is_on_beam = area <= MAX_OFFSET_M * length
    result: Mask = (gap > MIN_GAP_M) & is_on_beam & nearer.any(axis=1)
    return result
