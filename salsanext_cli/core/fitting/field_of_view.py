# SPDX-License-Identifier: MIT
"""Field of view of a sensor from a few of its scans."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from salsanext_cli.core.checks.scan_checks import MAX_SHARE_OUTSIDE, share_outside
from salsanext_cli.core.fitting.ego_fit import fit_ego
from salsanext_cli.core.fitting.mounting_fit import fit_mounting
from salsanext_cli.core.geometry.point_sample import measured_ranges
from salsanext_cli.core.geometry.sensor_frame import without_ego
from salsanext_cli.core.geometry.sensor_of_scan import sensor_of
from salsanext_cli.core.records import MAX_RANGE_M, Double, Scan
from salsanext_cli.core.sensors.sensor import FITTED_NAME, Sensor

OUTLIERS = 0.001  # Share of points above, and below, a complete field of view
SHOWN = 0.85  # Least share of points in a fitted field of view; more makes objects too low
MAX_ENLARGED = 1.2  # Largest extent of a complete field of view, as a multiple of training
CANDIDATES = 400  # Fields of view of one extent that are compared
NEARLY = 0.999  # Share of the most points at which a candidate is as good; the middle one is taken
MIN_VIEW_DEG = 1.0
EDGE_DEG = 60.0  # Farthest edge; rotating sensors had 52°
BEYOND_DEG = 5.0  # Farthest edge beyond the horizon; rotating sensors had 0°
MIN_VIEW_POINTS = 1000


@dataclass(frozen=True, slots=True, kw_only=True)
class _Edges:
    """Edges of a field of view in degrees."""

    lower: float
    upper: float


def fit_view(scans: Sequence[Scan], sensor: Sensor, *, mounting: bool = True) -> Sensor:
    """Return the sensor of weights, fitted to scans that differ much from it.

    `fit_mounting` and `fit_ego` fit the mounting and the vehicle. The field of view changes if more
    than `MAX_SHARE_OUTSIDE` of all points lie outside. Size and normalisation of the range images
    stay.

    Parameters
    ----------
    scans : sequence of Scan
        Some scans of the sensor.
    sensor : Sensor
        Sensor of weights, or one of which only the field of view is unknown.
    mounting : bool
        Whether to fit the mounting too; else that of the sensor and its name stay.

    Returns
    -------
    Sensor
    """
    sensor = fit_ego(scans, fit_mounting(scans, sensor) if mounting else sensor)
    sines = np.concatenate([np.empty(0)] + [_sines(scan, sensor) for scan in scans])
    if share_outside(sines, sensor) <= MAX_SHARE_OUTSIDE or len(sines) < MIN_VIEW_POINTS:
        return sensor
    elevations = np.degrees(np.arcsin(np.sort(sines)))
    edges = _field_of_view(elevations, sensor.fov_up - sensor.fov_down)
    is_beyond = (
        max(edges.upper, -edges.lower) > EDGE_DEG or max(edges.lower, -edges.upper) > BEYOND_DEG
    )
    if is_beyond or edges.upper - edges.lower < MIN_VIEW_DEG:
        return sensor
    name = FITTED_NAME if mounting else sensor.name
    return replace(sensor, name=name, fov_up=round(edges.upper, 2), fov_down=round(edges.lower, 2))


def _sines(scan: Scan, sensor: Sensor) -> Double:
    """Return the sines of elevation (M,) of the measured points outside the vehicle."""
    points = without_ego(scan, sensor_of(scan, sensor)).points
    ranges, is_measured = measured_ranges(points, float(MAX_RANGE_M))
    return points[is_measured, 2] / ranges[is_measured]


def _field_of_view(elevations: Double, extent: float) -> _Edges:
    """Return the field of view of rising elevations (N,) in degrees.

    It contains all points if it then is about as large as `extent` in training. Else it is as
    large, or larger to contain `SHOWN` of the points.
    """
    lowest, highest = np.quantile(elevations, (OUTLIERS, 1 - OUTLIERS)).tolist()
    if highest - lowest <= MAX_ENLARGED * extent:
        return _Edges(lower=lowest, upper=highest)
    count = int(SHOWN * len(elevations))
    narrowest = (elevations[count:] - elevations[: len(elevations) - count]).min()
    extent = max(narrowest, extent)
    lower = np.linspace(lowest, highest - extent, CANDIDATES)
    upper = np.searchsorted(elevations, lower + extent, "right")
    inside = upper - np.searchsorted(elevations, lower)
    best = np.flatnonzero(inside >= NEARLY * inside.max())
    start = float(lower[best[len(best) // 2]])
    return _Edges(lower=start, upper=start + float(extent))
