# SPDX-License-Identifier: MIT
"""Share of the points of scans that lies outside the field of view of a sensor."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from salsanext_cli.geometry.mounting import without_ego
from salsanext_cli.geometry.ranges import LARGEST, measured_ranges
from salsanext_cli.records import Scan
from salsanext_cli.sensors.sensor import Sensor

LARGEST_SHARE_OUTSIDE = 0.2
"""Largest share of points outside without a warning; a matching sensor has 0.07 or less."""


@dataclass(frozen=True, slots=True)
class FieldOfViewCoverage:
    """Numbers of points; adding two gives those of both."""

    points: int = 0  # Number of points with a measurement
    outside: int = 0  # Number of those above or below the field of view

    def __add__(self, other: FieldOfViewCoverage) -> FieldOfViewCoverage:
        return FieldOfViewCoverage(self.points + other.points, self.outside + other.outside)

    @property
    def share(self) -> float:
        """Share of the points that lies outside, 0…1; 0 without points."""
        return self.outside / max(self.points, 1)


def field_of_view_coverage(scan: Scan, sensor: Sensor) -> FieldOfViewCoverage:
    """Count the points of a scan in and out of view; `out_of_view` of the sensor has no effect."""
    scan = without_ego(scan, sensor)
    ranges, measured = measured_ranges(scan.points, float(LARGEST))
    ranges, z = ranges[measured], scan.points[measured, 2].astype(np.float64)
    lowest, highest = (math.sin(math.radians(f)) for f in (sensor.fov_down, sensor.fov_up))
    outside = (z < lowest * ranges) | (z > highest * ranges)
    return FieldOfViewCoverage(len(z), int(outside.sum()))
