# SPDX-License-Identifier: MIT
"""View, mounting and own vehicle of a sensor from a few of its scans."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from salsanext_cli.fitting.ego_fit import fit_ego
from salsanext_cli.fitting.mounting_fit import fit_mounting
from salsanext_cli.fitting.scan_checks import (
    LARGEST_SHARE_OUTSIDE,
    FieldOfViewCoverage,
    field_of_view_coverage,
)
from salsanext_cli.geometry.mounting import without_ego
from salsanext_cli.geometry.ranges import measured_ranges
from salsanext_cli.records import Scan
from salsanext_cli.sensors.sensor import FITTED_NAME, ORIGIN, UP, Sensor

OUTLIERS = 0.001
"""Share of the points above, and of those below, that no view needs to show."""
SHOWN = 0.85
"""Least share of the points that a fitted view shows; the whole view of a sensor that sees far up
and down would make objects much lower in the image than those of training."""
MOST_ENLARGED = 1.2
"""Largest extent of a view of all points that is taken as it is, as a multiple of training's."""
PLACES = 400
"""Places of a view of given extent that are tried."""
NEARLY = 0.999
"""Share of the most points in a view at which another is as good; of these, the middle one."""
MIN_VIEW_DEG = 1.0
MIN_POINTS = 1000


def fit_view(scans: Sequence[Scan], sensor: Sensor) -> Sensor:
    """Return the sensor with the view and the mounting of scans where they differ much.

    Points of housing and vehicle are left out, as `fit_ego` finds them. The mounting changes as
    `fit_mounting` says, the view where more than `LARGEST_SHARE_OUTSIDE` of
    all points lie outside. Size and normalisation of the range images stay. Of the labelled scans
    of three sensors, this was never worse than the view of the weights.

    `scans`: of one sensor; `sensor`: that of the weights.
    """
    sensor = fit_ego(scans, fit_mounting(scans, sensor))
    coverages = (field_of_view_coverage(scan, sensor) for scan in scans)
    coverage = sum(coverages, start=FieldOfViewCoverage())
    if coverage.share <= LARGEST_SHARE_OUTSIDE or coverage.points < MIN_POINTS:
        return sensor
    elevations = []
    for scan in scans:
        points = without_ego(scan, sensor).points
        ranges, measured = measured_ranges(points)
        elevations.append(np.degrees(np.arcsin(points[measured, 2] / ranges[measured])))
    lower, upper = _view(np.sort(np.concatenate(elevations)), sensor.fov_up - sensor.fov_down)
    if upper - lower < MIN_VIEW_DEG:
        return sensor
    return replace(sensor, name=FITTED_NAME, fov_up=round(upper, 2), fov_down=round(lower, 2))


def _view(elevations: npt.NDArray[np.float64], extent: float) -> tuple[float, float]:
    """Return the edges, lower first, of a view of elevations (N,) that rise, in degrees.

    It shows all points if it then is about as large as that of training; otherwise it is as large
    as that, or larger until it shows `SHOWN` of the points.
    """
    lowest, highest = map(float, np.quantile(elevations, (OUTLIERS, 1 - OUTLIERS)))
    if highest - lowest <= MOST_ENLARGED * extent:
        return lowest, highest
    shown = int(SHOWN * len(elevations))
    narrowest = (elevations[shown:] - elevations[: len(elevations) - shown]).min()
    extent = max(narrowest, extent)
    lower = np.linspace(lowest, highest - extent, PLACES)
    upper = np.searchsorted(elevations, lower + extent, "right")
    inside = upper - np.searchsorted(elevations, lower)
    best = np.flatnonzero(inside >= NEARLY * inside.max())
    start = float(lower[best[len(best) // 2]])
    return start, start + float(extent)


def ego_text(sensor: Sensor) -> str:
    """Describe where points are of the vehicle: ``nearer than 1 m, or in x -0.6…0.7, …``."""
    box = sensor.ego_box or ()
    sides = (f"{axis} {a:g}…{b:g}" for axis, a, b in zip("xyz", box, box[3:], strict=False))
    near = f"nearer than {sensor.min_range or 0:g} m"
    return f"{near}, or in {', '.join(sides)} m" if box else near


def view_text(sensor: Sensor) -> str:
    """Describe view and mounting: ``view +10.7° to -30.7°, origin (0.0, 0.0, 1.75)``."""
    up = "" if sensor.up == UP else f", up {sensor.up}"
    origin = "" if sensor.origin == ORIGIN else f", origin {sensor.origin}"
    return f"view {sensor.fov_up:+g}° to {sensor.fov_down:+g}°{up}{origin}"
