# SPDX-License-Identifier: MIT
"""Measures of a scan by which scans of another sensor or another way of recording are told apart.

They need no labels. Measures of one sensor vary with the location. `least_spread` is the least
deviation that counts as usual, since the compared scans may hardly differ.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from salsanext_cli.core.geometry.point_sample import few_points, measured_ranges
from salsanext_cli.core.geometry.scan_traits import sines_of
from salsanext_cli.core.geometry.sensor_frame import in_sensor_frame
from salsanext_cli.core.records import Double, Float, Mask, RangeImage, Scan
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.texts import percentage

FULL_ROW = 0.05  # Least share of the columns with a point in a row that counts
DIGITS = 4
LEAST = 1e-4  # Smallest value on a logarithmic scale
SAMPLE = 4096  # Points whose intensities are counted


@dataclass(frozen=True, slots=True)
class Measure:
    """A measure of scans and how it is compared."""

    name: str
    is_logarithmic: bool  # Whether ratios are compared, not differences
    least_spread: float  # Least deviation between scans of one sensor, on the compared scale
    form: str = ""  # Format of its values, such as ``{:.0f}°``; none for shares

    def text(self, value: float) -> str:
        """Return a value with its unit."""
        return self.form.format(value) if self.form else percentage(value)


MEASURES = (
    Measure("points of a scan", True, 0.1, "{:,.0f}"),
    Measure("share of the columns with points", False, 0.05),
    Measure("share of the rows with points", False, 0.05),
    Measure("share of the pixels with points", False, 0.05),
    Measure("lowest elevation", False, 1.0, "{:.1f}°"),
    Measure("highest elevation", False, 1.0, "{:.1f}°"),
    Measure("nearest range", True, 0.3, "{:.1f} m"),
    Measure("median range", True, 0.2, "{:.1f} m"),
    Measure("far range", True, 0.2, "{:.0f} m"),
    Measure("farthest range", True, 0.2, "{:.0f} m"),
    Measure("median intensity", True, 0.5, "{:.3g}"),
    Measure("upper intensity", True, 0.5, "{:.3g}"),
    Measure("number of different intensities", True, 0.3, "{:,.0f}"),
    Measure("relative change of intensity between columns", True, 0.3),
    Measure("relative noise of ranges", True, 0.5),
)
"""In the order of `measures_of`.

Least spreads are about those of 24 simulated drives with different streets; where these hardly
differ, such as in their field of view, a spread that weather and mounting may cause.
"""
RANGE_SHARES = (0.001, 0.5, 0.95, 0.999)  # Quantiles that are nearest, median, far and farthest
INTENSITY_SHARES = (0.5, 0.99)
ELEVATION_SHARES = (0.01, 0.99)


def measures_of(scan: Scan, image: RangeImage, sensor: Sensor) -> tuple[float, ...]:
    """Return the values of `MEASURES` of a scan.

    Parameters
    ----------
    scan : Scan
        Scan in the frame of its file.
    image : RangeImage
        The scan, projected for the sensor.
    sensor : Sensor
        Sensor that saw the scan.

    Returns
    -------
    tuple of float
        Zeros where the scan shows nothing, such as without an intensity.
    """
    seen = image.channels[0] > 0
    ranges = image.point_range[image.point_range > 0]
    few = in_sensor_frame(few_points(scan, SAMPLE), sensor)
    few = few.take(np.flatnonzero(measured_ranges(few.points)[1]))
    elevations = np.degrees(np.arcsin(sines_of(few.points)))
    intensity = few.intensity[np.isfinite(few.intensity)]
    values = (
        np.count_nonzero(measured_ranges(scan.points)[1]),
        seen.any(axis=0).mean(),
        (seen.mean(axis=1) > FULL_ROW).mean(),
        seen.mean(),
        *_quantiles(elevations, ELEVATION_SHARES),
        *_quantiles(ranges, RANGE_SHARES),
        *_quantiles(intensity, INTENSITY_SHARES),
        len(np.unique(intensity)),
        _change_of_intensity(image.channels[4], seen),
        _noise_of_ranges(image.channels[0], seen),
    )
    return tuple(round(float(value), DIGITS) for value in values)


def compared_measures(values: Double) -> Double:
    """Return measures (U, M) on the scales on which they are compared, (U, M) float64."""
    is_logarithmic = np.array([measure.is_logarithmic for measure in MEASURES])
    return np.where(is_logarithmic, np.log(np.maximum(values, LEAST)), values)


def _quantiles(values: Float, shares: tuple[float, ...]) -> Double:
    if not len(values):
        return np.zeros(len(shares))
    quantiles: Double = np.quantile(values, shares).astype(np.float64)
    return quantiles


def _change_of_intensity(intensity: Float, seen: Mask) -> float:
    """Return the median change between columns (H, W) as a share of the median, 0 if unknown."""
    pairs = seen[:, 1:] & seen[:, :-1]
    median = np.median(intensity[seen]) if seen.any() else 0
    if median <= 0 or not pairs.any():
        return 0.0
    return float(np.median(np.abs(np.diff(intensity, axis=1))[pairs]) / median)


def _noise_of_ranges(ranges: Float, seen: Mask) -> float:
    """Return the median second difference of ranges (H, W), lower half, as a share of them."""
    lower = len(ranges) // 2
    ranges = ranges[lower:]
    seen = seen[lower:]
    triples = seen[:, 2:] & seen[:, 1:-1] & seen[:, :-2]
    if not triples.any():
        return 0.0
    second = np.abs(np.diff(ranges, n=2, axis=1))[triples]
    return float(np.median(second / ranges[:, 1:-1][triples]))
