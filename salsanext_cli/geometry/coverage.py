# SPDX-License-Identifier: MIT
"""How much of a scan lies in the field of view of a sensor."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from salsanext_cli.geometry.projection_parameters import LARGEST
from salsanext_cli.records import Scan
from salsanext_cli.sensors import Sensor


@dataclass(frozen=True, slots=True)
class FieldOfViewCoverage:
    """Points by whether a sensor sees them; adding two gives the counts of both.

    Attributes
    ----------
    points : int
        Number of points with a measurement.
    outside : int
        How many of them lie above or below the field of view.
    """

    points: int = 0
    outside: int = 0

    def __add__(self, other: FieldOfViewCoverage) -> FieldOfViewCoverage:
        return FieldOfViewCoverage(self.points + other.points, self.outside + other.outside)

    @property
    def share(self) -> float:
        """Share of the points that lies outside, 0…1; 0 without points."""
        return self.outside / max(self.points, 1)


def field_of_view_coverage(scan: Scan, sensor: Sensor) -> FieldOfViewCoverage:
    """Count the points of a scan, whether the sensor clamps or drops those out of its view."""
    # A NaN that signals is no measurement either.
    with np.errstate(invalid="ignore"):
        points = scan.points.astype(np.float64)
    distance = np.sqrt(np.einsum("ni,ni->n", points, points))
    measured = (distance > 0) & (distance <= LARGEST)
    distance, z = distance[measured], points[measured, 2]
    lowest, highest = (math.sin(math.radians(f)) for f in (sensor.fov_down, sensor.fov_up))
    outside = (z < lowest * distance) | (z > highest * distance)
    return FieldOfViewCoverage(len(z), int(outside.sum()))
