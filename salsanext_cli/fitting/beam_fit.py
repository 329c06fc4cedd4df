# SPDX-License-Identifier: MIT
"""Elevations of the beams of a sensor from some of its scans."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from salsanext_cli.geometry.beam_rows import medians_of_rings
from salsanext_cli.geometry.mounting import without_ego
from salsanext_cli.geometry.ranges import LARGEST, measured_ranges
from salsanext_cli.records import Scan
from salsanext_cli.sensors.limits import MAX_BEAMS
from salsanext_cli.sensors.sensor import Sensor

MIN_RANGE_M = 1.0
"""Nearest range that counts: beams start some centimetres beside the origin."""
STEP_DEG = 0.01
SMOOTHINGS_DEG = (0.2, 0.1)
"""Half the widths of the Hann windows that smooth the histogram: dense beams need the
second, which takes noise for beams elsewhere."""
MIN_GAIN = 0.005
"""Least gain of a narrower window, as a share of the points close to a beam."""
MAX_VALLEY = 0.5
"""Largest share of the lower of two maxima that the histogram falls to between two beams."""
MIN_WEIGHT = 0.15
"""Least weight of a beam, as a share of that of one beside it."""
MIN_SHARE = 0.75
"""Least share of the points within a quarter of the distance to the next beam; evenly spread
elevations have a half."""
DIGITS = 2

Array = npt.NDArray[np.float64]


def fit_beams(scans: Sequence[Scan], sensor: Sensor) -> tuple[float, ...]:
    """Return the elevations of the beams in degrees from top to bottom, none if not discernible.

    Where all scans know rings, they are the medians of these. Otherwise they are the maxima of the
    histogram of elevations; points count by their range, since near ones are seen from beside the
    origin. Scans whose motion was taken out, or whose beams start far from the origin as those of
    an HDL-64, have no clear maxima.

    `scans`: of one sensor; `sensor`: its direction up.
    """
    elevations, ranges, rings = [np.empty(0)], [np.empty(0)], [np.empty(0, np.int32)]
    for scan in scans:
        points = without_ego(scan, sensor).points
        distance, measured = measured_ranges(points, float(LARGEST))
        measured &= distance > MIN_RANGE_M
        ranges.append(distance[measured])
        elevations.append(np.degrees(np.arcsin(points[measured, 2] / distance[measured])))
        if scan.ring is not None:
            rings.append(scan.ring[measured])
    elevation, ring = np.concatenate(elevations), np.concatenate(rings)
    found = _of_rings(elevation, ring) if len(ring) == len(elevation) else np.empty(0)
    if not len(found):
        found = _of_histogram(elevation, np.concatenate(ranges))
    beams = tuple(dict.fromkeys(found[::-1].round(DIGITS).tolist()))
    return beams if 2 <= len(beams) <= MAX_BEAMS else ()


def _of_rings(elevation: Array, ring: npt.NDArray[np.int32]) -> Array:
    """Return the medians of rings, rising; none if the points of a ring differ too much.

    So it is with columns of that name, or rows of organised clouds, that hold something else.
    """
    elevation, ring = elevation[ring >= 0], ring[ring >= 0]
    medians = medians_of_rings(elevation, ring)
    beams = np.sort(medians[np.isfinite(medians)])
    if len(beams) < 2:
        return np.empty(0)
    away = np.abs(elevation - medians[ring])
    return beams if np.median(away) < (beams[-1] - beams[0]) / len(beams) else np.empty(0)


def _of_histogram(elevation: Array, weight: Array) -> Array:
    """Return the maxima of the histogram, rising; none if the elevations lie between them too."""
    bins = round(180 / STEP_DEG)
    histogram = np.histogram(elevation, bins, (-90, 90), weights=weight)[0]
    best, beams = MIN_SHARE - MIN_GAIN, np.empty(0)
    for half_width in SMOOTHINGS_DEG:
        window = np.hanning(2 * round(half_width / STEP_DEG) + 1)
        places = _maxima(np.convolve(histogram, window, "same"))
        maxima = ((places + 0.5) * STEP_DEG - 90).astype(np.float64)
        share, found = _of_maxima(maxima, elevation, weight)
        if share >= best + MIN_GAIN:
            best, beams = share, found
    return beams


def _of_maxima(beams: Array, elevation: Array, weight: Array) -> tuple[float, Array]:
    """Return beams (B,) but for weak ones, after the share of the points that are close to one."""
    while len(beams) >= 2:
        nearest = np.searchsorted((beams[1:] + beams[:-1]) / 2, elevation)
        weights = np.bincount(nearest, weight, len(beams))
        others = np.pad(weights, 1)
        strong = weights >= MIN_WEIGHT * np.maximum(others[2:], others[:-2])
        if strong.all():
            gaps = np.diff(beams, prepend=-np.inf, append=np.inf)
            gap = np.minimum(gaps[1:], gaps[:-1])[nearest]
            close = weight[np.abs(elevation - beams[nearest]) < gap / 4].sum()
            return float(close / weight.sum()), beams
        beams = beams[strong]
    return 0.0, beams


def _maxima(values: Array) -> npt.NDArray[np.intp]:
    """Return the places of maxima between which the values fall to `MAX_VALLEY` of the lower."""
    rises = (values[1:-1] > values[:-2]) & (values[1:-1] >= values[2:])
    found: list[int] = []
    for place in (np.flatnonzero(rises) + 1).tolist():
        while found:
            lower = min(values[found[-1]], values[place])
            if values[found[-1] : place].min() <= MAX_VALLEY * lower:
                found.append(place)
                break
            if values[place] <= values[found[-1]]:
                break
            found.pop()
        else:
            found.append(place)
    return np.array(found, np.intp)
