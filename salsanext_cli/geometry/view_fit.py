# SPDX-License-Identifier: MIT
"""View and direction up of a sensor from a few of its scans."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from salsanext_cli.geometry.coverage import (
    LARGEST_SHARE_OUTSIDE,
    FieldOfViewCoverage,
    field_of_view_coverage,
)
from salsanext_cli.geometry.ground import Ground, find_ground
from salsanext_cli.geometry.mounting import upright
from salsanext_cli.geometry.ranges import measured_ranges
from salsanext_cli.records import Scan
from salsanext_cli.sensors import UP, Sensor

MAX_TILT_DEG = 25.0
"""Largest angle between the ground's normal and z of a sensor that stands upright; streets rise by
up to 20°."""
OUTLIERS = 0.001
"""Share of the points above, and of those below, that a fitted view leaves out."""
MIN_VIEW_DEG = 1.0
MIN_POINTS = 1000
MAX_POINTS = 4096
"""Points of a scan that are looked at for its ground and for its checks."""
DIGITS = 3


def fit_view(scans: Sequence[Scan], sensor: Sensor) -> Sensor:
    """Return the sensor with the view and the direction up of scans where they differ much.

    The direction up changes where the ground of most scans is tilted by more than `MAX_TILT_DEG`;
    the view where more than `LARGEST_SHARE_OUTSIDE` of all points lie outside. Size and
    normalisation of the range images stay. Of the labelled scans of three sensors, this was never
    worse than the view of the weights.

    Parameters
    ----------
    scans : sequence of Scan
        Of one sensor.
    sensor : Sensor
        That of the weights.
    """
    grounds = [ground for scan in scans if (ground := ground_of(scan))]
    tilted = [ground.up for ground in grounds if ground.tilt_deg > MAX_TILT_DEG]
    if len(tilted) > len(grounds) / 2:
        mean = np.mean(tilted, axis=0)
        up = tuple((mean / np.linalg.norm(mean)).round(DIGITS).tolist())
        sensor = replace(sensor, name="fitted", up=up)
    coverages = (field_of_view_coverage(scan, sensor) for scan in scans)
    coverage = sum(coverages, start=FieldOfViewCoverage())
    if coverage.share <= LARGEST_SHARE_OUTSIDE or coverage.points < MIN_POINTS:
        return sensor
    elevations = []
    for scan in scans:
        points = upright(scan, sensor).points
        ranges, measured = measured_ranges(points)
        elevations.append(np.degrees(np.arcsin(points[measured, 2] / ranges[measured])))
    edges = np.quantile(np.concatenate(elevations), (OUTLIERS, 1 - OUTLIERS))
    lower, upper = (round(float(edge), 2) for edge in edges)
    if upper - lower < MIN_VIEW_DEG:
        return sensor
    return replace(sensor, name="fitted", fov_up=upper, fov_down=lower)


def ground_of(scan: Scan) -> Ground | None:
    """Find the ground in a scan, from some of its points."""
    some = few_points(scan).points
    return find_ground(some[np.isfinite(some).all(axis=1)])


def few_points(scan: Scan) -> Scan:
    """Return `MAX_POINTS` points of a scan, drawn alike for each; all if there are no more.

    Of points in the order of a grid, every n-th could be of few beams or in few directions.
    """
    if len(scan) <= MAX_POINTS:
        return scan
    drawn = np.random.default_rng(0).integers(0, len(scan), MAX_POINTS)
    return Scan(scan.points[drawn], scan.intensity[drawn])


def as_found(sensor: Sensor) -> str:
    """Describe a view: ``view +10.7° to -30.7°``, and the direction up if it is not z."""
    up = "" if sensor.up == UP else f", up {sensor.up}"
    return f"view {sensor.fov_up:+g}° to {sensor.fov_down:+g}°{up}"
