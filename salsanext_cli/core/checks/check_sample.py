# SPDX-License-Identifier: MIT
"""Sample of the points of a scan, by which it is checked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from salsanext_cli.core.checks.structure_checks import survey_hint
from salsanext_cli.core.errors import FormatError
from salsanext_cli.core.geometry.point_sample import few_points, measured_ranges
from salsanext_cli.core.geometry.scan_traits import MIN_TRAIT_POINTS
from salsanext_cli.core.geometry.sensor_frame import ego_points, in_sensor_frame
from salsanext_cli.core.records import Double, Scan
from salsanext_cli.core.sensors.sensor import ORIGIN, Sensor

MEDIAN_RANGES_M = (0.3, 250.0)  # Possible median ranges of a scan in metres; real scans had 4 to 32


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CheckSample:
    """Measured points of a scan, without points on the vehicle.

    Attributes
    ----------
    measured : Scan
        M points in the frame of the sensor.
    ranges : (M,) float64
        Their distances from the sensor, in metres.
    measured_share : float
        Share of the points beside the vehicle, 0…1, that have a measurement.
    ego_share : float
        Share of all points, 0…1, on the housing of the sensor or its vehicle.
    """

    measured: Scan
    ranges: Double
    measured_share: float
    ego_share: float


def check_sample(source: object, scan: Scan, sensor: Sensor) -> CheckSample:
    """Return a sample of the points of a scan; all of them, if few of the sample are measured.

    Parameters
    ----------
    source : object
        Name of the scan in errors.
    scan : Scan
        N points in the frame of their file.
    sensor : Sensor
        Sensor that the scan is projected for.

    Returns
    -------
    CheckSample

    Raises
    ------
    FormatError
        If the points are not in metres around a sensor.
    """
    sample = in_sensor_frame(few_points(scan), sensor)
    ranges, is_measured = measured_ranges(sample.points)
    if len(sample) < len(scan) and is_measured.sum() < MIN_TRAIT_POINTS:
        sample = in_sensor_frame(scan, sensor)
        ranges, is_measured = measured_ranges(sample.points)
    _require_metres(source, scan, ranges[is_measured])
    ego = ego_points(sample.points, sensor)
    ego_share = len(ego) / max(len(sample), 1)
    if len(ego):
        sample = sample.take(np.delete(np.arange(len(sample)), ego))
        ranges, is_measured = measured_ranges(sample.points)
    return CheckSample(
        measured=Scan(sample.points[is_measured], sample.intensity[is_measured]),
        ranges=ranges[is_measured],
        measured_share=int(is_measured.sum()) / max(len(sample), 1),
        ego_share=ego_share,
    )


def _require_metres(source: object, scan: Scan, ranges: Double) -> None:
    """Refuse points without a measurement, or whose ranges (M,) are not those of a sensor."""
    count = len(scan)
    if count >= MIN_TRAIT_POINTS and not len(ranges):
        problem = f"none of its {count} points is a measurement"
        raise FormatError(source, problem, "finite coordinates around the sensor")
    if len(ranges) < MIN_TRAIT_POINTS:
        return
    median = float(np.median(ranges))
    least, most = MEDIAN_RANGES_M
    if median > most and scan.notes.frame != ORIGIN:
        problem = "is in map coordinates, and its points show no sensor, as in a survey"
        raise FormatError(source, problem, "scans of a sensor", survey_hint())
    if not least <= median <= most:
        expected = "coordinates in metres, with the sensor at the origin"
        hint = "convert other units; subtract the position of the sensor from map coordinates"
        raise FormatError(source, f"has a median range of {median:.3g} m", expected, hint)
