# SPDX-License-Identifier: MIT
"""View, mounting and own vehicle of a sensor from a few of its scans."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from salsanext_cli.fitting.mounting_fit import fit_mounting, ground_of
from salsanext_cli.fitting.scan_checks import MAX_SHARE_OUTSIDE, share_outside
from salsanext_cli.geometry.projection import (
    in_sensor_frame,
    measured_ranges,
    medians_of_rings,
    without_ego,
)
from salsanext_cli.records import MAX_RANGE_M, Double, Float, Indices, Int, Mask, Scan
from salsanext_cli.sensors.sensor import FITTED_NAME, MAX_BEAMS, ORIGIN, UP, Sensor

MIN_RANGE_OF_BEAMS_M = 1.0
"""Nearest range that counts: beams start some centimetres beside the origin."""
STEP_DEG = 0.01
SMOOTHINGS_DEG = (0.2, 0.1)
"""Half the widths of the Hann windows that smooth the histogram: dense beams need the
second, which takes noise for beams elsewhere."""
MIN_GAIN = 0.005  # Least gain of a narrower window, as a share of the points close to a beam
MAX_VALLEY = 0.5
"""Largest share of the lower of two maxima that the histogram falls to between two beams."""
MIN_WEIGHT = 0.15  # Least weight of a beam, as a share of that of one beside it
MIN_SHARE = 0.75
"""Least share of the points within a quarter of the distance to the next beam; evenly spread
elevations have a half."""
DIGITS = 2


def fit_beams(scans: Sequence[Scan], sensor: Sensor) -> tuple[float, ...]:
    """Return the elevations of the beams in degrees from top to bottom, none if not discernible."""
    # Where all scans know rings, they are the medians of these. Otherwise they are the maxima of
    # the histogram of elevations; points count by their range, since near ones are seen from beside
    # the origin. Scans whose motion was taken out, or whose beams start far from the origin as
    # those of an HDL-64, have no clear maxima.
    elevations, ranges, rings = [np.empty(0)], [np.empty(0)], [np.empty(0, np.int32)]
    for scan in scans:
        sines, distance, measured = _sines(scan, sensor)
        far = distance > MIN_RANGE_OF_BEAMS_M
        ranges.append(distance[far])
        elevations.append(np.degrees(np.arcsin(sines[far])))
        if scan.ring is not None:
            rings.append(scan.ring[measured][far])
    elevation, ring = np.concatenate(elevations), np.concatenate(rings)
    rising = _of_rings(elevation, ring) if len(ring) == len(elevation) else np.empty(0)
    if not len(rising):
        rising = _of_histogram(elevation, np.concatenate(ranges))
    beams = tuple(dict.fromkeys(rising[::-1].round(DIGITS).tolist()))
    return beams if 2 <= len(beams) <= MAX_BEAMS else ()


def _sines(scan: Scan, sensor: Sensor) -> tuple[Double, Double, Mask]:
    """Return sines of elevation and ranges (M,) of the measured points, and which these are."""
    points = without_ego(scan, sensor).points
    ranges, measured = measured_ranges(points, float(MAX_RANGE_M))
    return points[measured, 2] / ranges[measured], ranges[measured], measured


def _of_rings(elevation: Double, ring: Int) -> Double:
    """Return the medians of rings, rising; none if they seem to hold something else."""
    elevation, ring = elevation[ring >= 0], ring[ring >= 0]
    medians = medians_of_rings(elevation, ring)
    beams = np.sort(medians[np.isfinite(medians)])
    if len(beams) < 2:
        return np.empty(0)
    away = np.abs(elevation - medians[ring])
    return beams if np.median(away) < (beams[-1] - beams[0]) / len(beams) else np.empty(0)


def _of_histogram(elevation: Double, weight: Double) -> Double:
    """Return the maxima of the histogram, rising; none if the elevations lie between them too."""
    bins = round(180 / STEP_DEG)
    histogram = np.histogram(elevation, bins, (-90, 90), weights=weight)[0]
    best, beams = MIN_SHARE - MIN_GAIN, np.empty(0)
    for half_width in SMOOTHINGS_DEG:
        window = np.hanning(2 * round(half_width / STEP_DEG) + 1)
        places = _maxima(np.convolve(histogram, window, "same"))
        maxima = ((places + 0.5) * STEP_DEG - 90).astype(np.float64)
        share, strong = _of_maxima(maxima, elevation, weight)
        if share >= best + MIN_GAIN:
            best, beams = share, strong
    return beams


def _of_maxima(beams: Double, elevation: Double, weight: Double) -> tuple[float, Double]:
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


def _maxima(values: Double) -> Indices:
    """Return the places of maxima between which the values fall to `MAX_VALLEY` of the lower."""
    rises = (values[1:-1] > values[:-2]) & (values[1:-1] >= values[2:])
    places: list[int] = []
    for place in (np.flatnonzero(rises) + 1).tolist():
        while places:
            lower = min(values[places[-1]], values[place])
            if values[places[-1] : place].min() <= MAX_VALLEY * lower:
                places.append(place)
                break
            if values[place] <= values[places[-1]]:
                break
            places.pop()
        else:
            places.append(place)
    return np.array(places, np.intp)


MIN_RANGE_M = 1.0
"""Range below which only housing and mount were seen, of four vehicles; the street began at 1.3."""
SHARE_OF_HEIGHT = 0.8
"""Largest minimum range, as a share of the height above the ground: a low sensor sees its floor."""
MIN_HEIGHT_M = 0.1  # Least height of a sensor above what can be the ground that it stands on
FARTHEST_M = 3.0  # Farthest body of a vehicle that is sought
MIN_SCANS = 5
AZIMUTHS, ELEVATIONS = 120, 120  # Cells around, and from straight down to straight up
MIN_CELLS = 5
"""Fewest cells of a body; of SemanticKITTI's car, which is not seen, was one by chance."""
CENTRES = ((np.arange(ELEVATIONS) + 0.5) / ELEVATIONS - 0.5) * np.pi
TOLERANCE_M = 0.1
"""Largest difference between the nearest range of a cell and its usual one, if it stays."""
SEEN, STAYS = 0.9, 0.8
"""Least share of the scans in which a cell of the vehicle has a point, and of those in which its
range stays."""
MOVING = 0.15
"""Largest share of the farther cells above the ground whose range stays, if the vehicle moves."""
ABOVE_GROUND_M = 0.4  # Height above the ground of what is not the ground
MARGIN_M = 0.05
WIDEST_M = 2.6
"""Largest of the lesser of length and width of a vehicle; wider is something beside it, and so is
what begins more than `MIN_RANGE_M` from the axis of the sensor."""


def fit_ego(scans: Sequence[Scan], sensor: Sensor) -> Sensor:
    """Return the sensor with `min_range` and `ego_box` where they are None: to be found."""
    # The minimum range is `MIN_RANGE_M`, less where the sensor is lower than usual above the
    # ground. The box is empty where the scans do not tell it: fewer than `MIN_SCANS` of one drive,
    # or those of a vehicle that stands.
    least, box = sensor.min_range, sensor.ego_box
    if least is not None and box is not None:
        return sensor
    upright = [in_sensor_frame(scan, sensor) for scan in scans]
    heights = [ground.height for scan in upright if (ground := ground_of(scan))]
    height = float(np.median(heights)) if heights else None
    if least is None:
        least = MIN_RANGE_M
        if height is not None and height >= MIN_HEIGHT_M:
            least = round(min(least, SHARE_OF_HEIGHT * height), DIGITS)
    if box is None:
        box = _ego_box(upright, height) if height is not None and len(scans) >= MIN_SCANS else ()
    return replace(sensor, min_range=least, ego_box=box)


def _ego_box(scans: Sequence[Scan], height: float) -> tuple[float, ...]:
    """Return the box of upright scans of a sensor at a height in metres, empty without one."""
    least_z = ABOVE_GROUND_M - height
    nearest = np.full((len(scans), AZIMUTHS * ELEVATIONS), np.inf)
    for scan, of_scan in zip(scans, nearest, strict=True):
        np.minimum.at(of_scan, *_in_cells(scan.points))
    seen = np.isfinite(nearest).mean(axis=0)
    with np.errstate(invalid="ignore"):  # of a cell that no scan has a point in
        usual = np.sort(nearest, axis=0)[(seen * len(scans) / 2).astype(int), np.arange(len(seen))]
        stays = (np.abs(nearest - usual) < TOLERANCE_M).sum(axis=0) / (seen * len(scans))
        rises = usual * np.tile(np.sin(CENTRES), AZIMUTHS) > least_z
    always = seen >= SEEN
    far = always & rises & (usual > FARTHEST_M)
    if not far.any() or (stays[far] >= STAYS).mean() > MOVING:
        return ()
    body_cells = always & rises & (usual <= FARTHEST_M) & (stays >= STAYS)
    if body_cells.sum() < MIN_CELLS:
        return ()
    reach = np.where(body_cells, usual + TOLERANCE_M, 0)
    body = []
    for scan in scans:
        cells, ranges = _in_cells(scan.points)
        own = (ranges < reach[cells]) & (scan.points[:, 2] > least_z)
        body.append(scan.points[own])
    points = np.concatenate(body)
    lowest, highest = points.min(axis=0) - MARGIN_M, points.max(axis=0) + MARGIN_M
    gap = np.hypot(*np.maximum.reduce([lowest, -highest, np.zeros(3)])[:2])
    if (highest - lowest)[:2].min() > WIDEST_M or gap > MIN_RANGE_M:
        return ()
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


OUTLIERS = 0.001  # Share of the points above, and of those below, that no view needs to show
SHOWN = 0.85
"""Least share of the points that a fitted view shows; the whole view of a sensor that sees far up
and down would make objects much lower in the image than those of training."""
MAX_ENLARGED = 1.2
"""Largest extent of a view of all points that is taken as it is, as a multiple of training's."""
PLACES = 400  # Places of a view of given extent that are tried
NEARLY = 0.999
"""Share of the most points in a view at which another is as good; of these, the middle one."""
MIN_VIEW_DEG = 1.0
MIN_VIEW_POINTS = 1000


def fit_view(scans: Sequence[Scan], sensor: Sensor) -> Sensor:
    """Return the sensor of weights with the view and mounting of scans where they differ much."""
    # Points of housing and vehicle are left out, as `fit_ego` finds them. The mounting changes as
    # `fit_mounting` says, the view where more than `MAX_SHARE_OUTSIDE` of all points lie
    # outside. Size and normalisation of the range images stay. Of the labelled scans of three
    # sensors, this was never worse than the view of the weights.
    sensor = fit_ego(scans, fit_mounting(scans, sensor))
    sines = np.concatenate([np.empty(0), *(_sines(scan, sensor)[0] for scan in scans)])
    if share_outside(sines, sensor) <= MAX_SHARE_OUTSIDE or len(sines) < MIN_VIEW_POINTS:
        return sensor
    elevations = np.degrees(np.arcsin(np.sort(sines)))
    lower, upper = _view(elevations, sensor.fov_up - sensor.fov_down)
    if upper - lower < MIN_VIEW_DEG:
        return sensor
    return replace(sensor, name=FITTED_NAME, fov_up=round(upper, 2), fov_down=round(lower, 2))


def _view(elevations: Double, extent: float) -> tuple[float, float]:
    """Return lower and upper edge in degrees of a view of elevations (N,) that rise."""
    # Of all points, if it then is about as large as that of training; else as large, or larger
    # until it shows `SHOWN` of the points.
    lowest, highest = map(float, np.quantile(elevations, (OUTLIERS, 1 - OUTLIERS)))
    if highest - lowest <= MAX_ENLARGED * extent:
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
