# SPDX-License-Identifier: MIT
"""Rows of points in a range image with a row, or several, per beam."""

import numpy as np
import numpy.typing as npt

from salsanext_cli.geometry.ranges import LARGEST, measured_ranges
from salsanext_cli.records import Int, Scan
from salsanext_cli.sensors.sensor import Sensor


def rows_of(scan: Scan, sensor: Sensor) -> Int | None:
    """Return the row of each point, that of its beam; None where the sensor knows no beams.

    Of B beams, number b from the top has row ``floor((b + ½) H / B)``: with as many beams as rows
    each has its own, with fewer some rows stay empty, with more some share one.

    `scan`: upright. Points of one ring are of one beam, that nearest to the median of their
    elevations; points without a ring are of the beam nearest to their own; `sensor`: its beams and
    the rows of its range image.

    Returns (N,) int32 or None, from 0 at the top; points without a measurement have any row.
    """
    if not sensor.beams:
        return None
    ranges, measured = measured_ranges(scan.points, float(LARGEST))
    slopes = np.zeros(len(scan))
    np.divide(scan.points[:, 2], ranges, out=slopes, where=measured)
    beams = np.radians(sensor.beams)
    borders = -np.sin((beams[1:] + beams[:-1]) / 2)
    beam = np.searchsorted(borders, -slopes)
    if scan.ring is not None:
        known = measured & (scan.ring >= 0)
        medians = medians_of_rings(slopes[known], scan.ring[known])
        beam[known] = np.searchsorted(borders, -medians)[scan.ring[known]]
    rows: Int = ((2 * beam + 1) * sensor.height // (2 * len(beams))).astype(np.int32)
    return rows


def medians_of_rings(values: npt.NDArray[np.float64], ring: Int) -> npt.NDArray[np.float64]:
    """Return the median of the values (N,) of each ring, by number; NaN where it has none."""
    order = np.argsort(ring, kind="stable")
    numbers, starts = np.unique(ring[order], return_index=True)
    medians = np.full(ring.max(initial=-1) + 1, np.nan)
    for number, part in zip(numbers, np.split(values[order], starts[1:]), strict=False):
        medians[number] = np.median(part)
    return medians
