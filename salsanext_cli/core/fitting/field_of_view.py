# SPDX-License-Identifier: MIT
"""Field of view, mounting and vehicle of a sensor from a few of its scans."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from salsanext_cli.core.checks.scan_checks import MAX_SHARE_OUTSIDE, share_outside
from salsanext_cli.core.fitting.mounting_fit import fit_mounting
from salsanext_cli.core.geometry.ground import ground_of
from salsanext_cli.core.geometry.projection import in_sensor_frame, measured_ranges, without_ego
from salsanext_cli.core.geometry.sensor_of_scan import sensor_of
from salsanext_cli.core.records import MAX_RANGE_M, Double, Float, Indices, Scan
from salsanext_cli.core.sensors.sensor import FITTED_NAME, ORIGIN, UP, Sensor

DIGITS = 2
MIN_RANGE_M = 1.0  # Only housing and mount of four vehicles were nearer; the road began at 1.3
SHARE_OF_HEIGHT = 0.8  # Bound of the minimum range by the height: a low sensor sees its floor
MIN_SENSOR_HEIGHT_M = 0.1  # Least height of a sensor above the ground
FARTHEST_M = 3.0  # Farthest point of the body of a vehicle
MIN_SCANS = 5
AZIMUTHS, ELEVATIONS = 120, 120  # Cells around, and from straight down to straight up
MIN_CELLS = 5  # Fewest cells of a body; scans of SemanticKITTI, without a body, had one by chance
CENTRES = ((np.arange(ELEVATIONS) + 0.5) / ELEVATIONS - 0.5) * np.pi
TOLERANCE_M = 0.1  # Largest difference of the nearest range of a constant cell
SEEN, CONSTANT = 0.9, 0.8  # Least shares of scans in which a body cell has a point, and is constant
MOVING = 0.15  # Largest share of constant cells among farther ones if the vehicle moves
ABOVE_GROUND_M = 0.4  # Least height of a body above the ground
MARGIN_M = 0.05
WIDEST_M = 2.6  # Largest width of a vehicle


def fit_ego(scans: Sequence[Scan], sensor: Sensor) -> Sensor:
    """Return the sensor with `min_range` and `ego_box` fitted to its scans where they are None.

    The minimum range is `MIN_RANGE_M`, or less for a low sensor. The box is empty for fewer than
    `MIN_SCANS` scans, if the vehicle stands, and for registered scans, in which it turns.
    """
    least, box = sensor.min_range, sensor.ego_box
    if least is not None and box is not None:
        return sensor
    upright = [in_sensor_frame(scan, sensor_of(scan, sensor)) for scan in scans]
    heights = [ground.height for scan in upright if (ground := ground_of(scan))]
    height = float(np.median(heights)) if heights else None
    if least is None:
        least = MIN_RANGE_M
        if height is not None and height >= MIN_SENSOR_HEIGHT_M:
            least = round(min(least, SHARE_OF_HEIGHT * height), DIGITS)
    if box is None:
        shows_box = height is not None and len(scans) >= MIN_SCANS and not sensor.registered
        box = _ego_box(upright, height) if shows_box and height is not None else ()
    return replace(sensor, min_range=least, ego_box=box)


def _ego_box(scans: Sequence[Scan], height: float) -> tuple[float, ...]:
    """Return the box of the vehicle in upright scans from a height in metres; empty without one."""
    least_z = ABOVE_GROUND_M - height
    nearest = np.full((len(scans), AZIMUTHS * ELEVATIONS), np.inf)
    for scan, ranges in zip(scans, nearest, strict=True):
        np.minimum.at(ranges, *_in_cells(scan.points))
    seen = np.isfinite(nearest).mean(axis=0)
    with np.errstate(invalid="ignore"):  # A cell without a point in any scan
        median = np.sort(nearest, axis=0)[(seen * len(scans) / 2).astype(int), np.arange(len(seen))]
        constant = (np.abs(nearest - median) < TOLERANCE_M).sum(axis=0) / (seen * len(scans))
        rises = median * np.tile(np.sin(CENTRES), AZIMUTHS) > least_z
    always = seen >= SEEN
    far = always & rises & (median > FARTHEST_M)
    if not far.any() or (constant[far] >= CONSTANT).mean() > MOVING:
        return ()
    body_cells = always & rises & (median <= FARTHEST_M) & (constant >= CONSTANT)
    if body_cells.sum() < MIN_CELLS:
        return ()
    reach = np.where(body_cells, median + TOLERANCE_M, 0)
    body = []
    for scan in scans:
        cells, ranges = _in_cells(scan.points)
        body.append(scan.points[(ranges < reach[cells]) & (scan.points[:, 2] > least_z)])
    points = np.concatenate(body)
    lowest, highest = points.min(axis=0) - MARGIN_M, points.max(axis=0) + MARGIN_M
    gap = np.hypot(*np.maximum.reduce([lowest, -highest, np.zeros(3)])[:2])
    if (highest - lowest)[:2].min() > WIDEST_M or gap > MIN_RANGE_M:
        return ()  # Something beside the vehicle
    return tuple(np.concatenate([lowest, highest]).astype(np.float64).round(DIGITS).tolist())


def _in_cells(points: Float) -> tuple[Indices, Double]:
    """Return the cell and the range of each point (N, 3); infinite below `MIN_RANGE_M`."""
    ranges, measured = measured_ranges(points)
    usable = measured & (ranges >= MIN_RANGE_M)
    x, y, z = np.where(usable[:, None], points, np.float32(1)).T
    around = (np.arctan2(y, x) / (2 * np.pi) + 0.5) * AZIMUTHS
    upwards = (np.arctan2(z, np.hypot(x, y)) / np.pi + 0.5) * ELEVATIONS
    cells = around.astype(np.intp) % AZIMUTHS * ELEVATIONS
    cells += upwards.astype(np.intp).clip(0, ELEVATIONS - 1)
    return cells, np.where(usable, ranges, np.inf)


OUTLIERS = 0.001  # Share of points above, and below, a complete field of view
SHOWN = 0.85  # Least share of points in a fitted field of view; more makes objects too low
MAX_ENLARGED = 1.2  # Largest extent of a complete field of view, as a multiple of training
CANDIDATES = 400  # Fields of view of a given extent that are compared
NEARLY = 0.999  # Share of the most points at which a candidate is as good; the middle one is taken
MIN_VIEW_DEG = 1.0
EDGE_DEG, BEYOND_DEG = 60.0, 5.0
"""Farthest edge, and farthest edge beyond the horizon; rotating sensors had 52° and 0°."""
MIN_VIEW_POINTS = 1000


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
    sines = np.concatenate([np.empty(0), *(_sines(scan, sensor) for scan in scans)])
    if share_outside(sines, sensor) <= MAX_SHARE_OUTSIDE or len(sines) < MIN_VIEW_POINTS:
        return sensor
    elevations = np.degrees(np.arcsin(np.sort(sines)))
    lower, upper = _field_of_view(elevations, sensor.fov_up - sensor.fov_down)
    beyond = max(upper, -lower) > EDGE_DEG or max(lower, -upper) > BEYOND_DEG
    if beyond or upper - lower < MIN_VIEW_DEG:
        return sensor
    name = FITTED_NAME if mounting else sensor.name
    return replace(sensor, name=name, fov_up=round(upper, 2), fov_down=round(lower, 2))


def _sines(scan: Scan, sensor: Sensor) -> Double:
    """Return the sines of elevation (M,) of the measured points outside the vehicle."""
    points = without_ego(scan, sensor_of(scan, sensor)).points
    ranges, measured = measured_ranges(points, float(MAX_RANGE_M))
    return points[measured, 2] / ranges[measured]


def _field_of_view(elevations: Double, extent: float) -> tuple[float, float]:
    """Return lower and upper edge in degrees of the field of view of rising elevations (N,).

    It contains all points if it then is about as large as `extent` in training. Else it is as
    large, or larger to contain `SHOWN` of the points.
    """
    lowest, highest = map(float, np.quantile(elevations, (OUTLIERS, 1 - OUTLIERS)))
    if highest - lowest <= MAX_ENLARGED * extent:
        return lowest, highest
    shown = int(SHOWN * len(elevations))
    narrowest = (elevations[shown:] - elevations[: len(elevations) - shown]).min()
    extent = max(narrowest, extent)
    lower = np.linspace(lowest, highest - extent, CANDIDATES)
    upper = np.searchsorted(elevations, lower + extent, "right")
    inside = upper - np.searchsorted(elevations, lower)
    best = np.flatnonzero(inside >= NEARLY * inside.max())
    start = float(lower[best[len(best) // 2]])
    return start, start + float(extent)


def ego_text(sensor: Sensor) -> str:
    """Describe the region of the vehicle: ``nearer than 1 m, or in x -0.6…0.7, …``."""
    box = sensor.ego_box or ()
    sides = (f"{axis} {a:g}…{b:g}" for axis, a, b in zip("xyz", box, box[3:], strict=False))
    near = f"nearer than {sensor.min_range or 0:g} m"
    return f"{near}, or in {', '.join(sides)} m" if box else near


def image_text(sensor: Sensor, trained: Sensor | None = None) -> str:
    """Describe the range images: ``64×512, field of view +3° to -25° (of the weights)``.

    Parameters
    ----------
    sensor : Sensor
        Sensor of the images.
    trained : Sensor, optional
        Sensor of the weights, to state where the field of view is from.

    Returns
    -------
    str
    """
    text = f"{sensor.height}×{sensor.width}, {view_text(sensor)}"
    if trained is None:
        return text
    if view_text(sensor) == view_text(trained):
        return f"{text} (of the weights)"
    if sensor.name not in (trained.name, FITTED_NAME):
        return f"{text} (sensor {sensor.name})"
    is_view_kept = (sensor.fov_up, sensor.fov_down) == (trained.fov_up, trained.fov_down)
    return f"{text} ({'mounting fitted' if is_view_kept else 'fitted'})"


def view_text(sensor: Sensor) -> str:
    """Describe field of view and mounting: ``field of view +10.7° to -30.7°, up …``."""
    up = "" if sensor.up == UP else f", up {sensor.up}"
    origin = "" if sensor.origin == ORIGIN else f", origin {sensor.origin}"
    registered = ", an origin for each scan" if sensor.registered else ""
    return f"field of view {sensor.fov_up:+g}° to {sensor.fov_down:+g}°{up}{origin}{registered}"
