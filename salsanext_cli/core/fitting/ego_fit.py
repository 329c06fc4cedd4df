# SPDX-License-Identifier: MIT
"""Housing and vehicle of a sensor, whose points are no measurements, from a few of its scans."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from salsanext_cli.core.geometry.ground import UPWARDS, ground_of
from salsanext_cli.core.geometry.point_sample import measured_ranges
from salsanext_cli.core.geometry.sensor_frame import in_sensor_frame
from salsanext_cli.core.geometry.sensor_of_scan import sensor_of
from salsanext_cli.core.records import Double, Float, Indices, Mask, Scan
from salsanext_cli.core.sensors.sensor import Sensor

DIGITS = 2
MIN_RANGE_M = 1.0  # Only housing and mount of four vehicles were nearer; the road began at 1.3
SHARE_OF_HEIGHT = 0.8  # Bound of the minimum range by the height: a low sensor sees its floor
MIN_SENSOR_HEIGHT_M = 0.1  # Least height of a sensor above the ground
FARTHEST_M = 3.0  # Farthest point of the body of a vehicle
MIN_SCANS = 5
AZIMUTHS = 120  # Cells around
ELEVATIONS = 120  # Cells from straight down to straight up
MIN_CELLS = 5  # Fewest cells of a body; scans of SemanticKITTI, without a body, had one by chance
CENTRES = ((np.arange(ELEVATIONS) + 0.5) / ELEVATIONS - 0.5) * np.pi
TOLERANCE_M = 0.1  # Largest difference of the nearest range of a constant cell
SEEN = 0.9  # Least share of scans in which a body cell has a point
CONSTANT = 0.8  # Least share of scans in which its nearest range is the same
MOVING = 0.15  # Largest share of constant cells among farther ones if the vehicle moves
ABOVE_GROUND_M = 0.4  # Least height of a body above the ground
MARGIN_M = 0.05
WIDEST_M = 2.6  # Largest width of a vehicle


@dataclass(frozen=True, slots=True, eq=False)
class _Cells:
    """Directions of N points, and their ranges."""

    cell_of_point: Indices  # (N,)
    ranges: Double  # (N,) metres; infinite below `MIN_RANGE_M`


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _CellRanges:
    """Nearest range of each cell over all scans, C cells."""

    median: Double  # (C,) metres; infinite without a point in most scans
    seen: Double  # (C,) share of the scans with a point, 0…1
    constant: Double  # (C,) share of these in which the range is about the median, 0…1


def fit_ego(scans: Sequence[Scan], sensor: Sensor) -> Sensor:
    """Return the sensor with `min_range` and `ego_box` fitted to its scans where they are None.

    The minimum range is `MIN_RANGE_M`, or less for a low sensor. The box is empty for fewer than
    `MIN_SCANS` scans, if the vehicle stands, and for registered scans, in which it turns.

    Parameters
    ----------
    scans : sequence of Scan
        A few scans of the sensor, in the frame of their files.
    sensor : Sensor
        Sensor whose mounting is known.

    Returns
    -------
    Sensor
    """
    least = sensor.min_range
    box = sensor.ego_box
    if least is not None and box is not None:
        return sensor
    upright = [in_sensor_frame(scan, sensor_of(scan, sensor)) for scan in scans]
    grounds = [ground_of(scan) for scan in upright]
    heights = [ground.height for ground in grounds if ground]
    height = float(np.median(heights)) if heights else None
    if least is None:
        least = MIN_RANGE_M
        if height is not None and height >= MIN_SENSOR_HEIGHT_M:
            least = round(min(least, SHARE_OF_HEIGHT * height), DIGITS)
    if box is None:
        shows_box = len(scans) >= MIN_SCANS and not sensor.registered
        box = _ego_box(upright, height) if shows_box and height is not None else ()
    return replace(sensor, min_range=least, ego_box=box)


def _ego_box(scans: Sequence[Scan], height: float) -> tuple[float, ...]:
    """Return the box of the vehicle in upright scans from a height in metres; empty without one."""
    least_z = ABOVE_GROUND_M - height
    cells_of_scans = [_cells(scan.points) for scan in scans]
    cell_ranges = _cell_ranges(cells_of_scans)
    is_body = _body_cells(cell_ranges, least_z)
    if is_body is None:
        return ()
    reach = np.where(is_body, cell_ranges.median + TOLERANCE_M, 0)
    body = []
    for scan, cells in zip(scans, cells_of_scans, strict=True):
        is_within = cells.ranges < reach[cells.cell_of_point]
        body.append(scan.points[is_within & (scan.points[:, UPWARDS] > least_z)])
    points = np.concatenate(body)
    lowest = points.min(axis=0) - MARGIN_M
    highest = points.max(axis=0) + MARGIN_M
    gap_ahead, gap_aside, _ = np.maximum.reduce([lowest, -highest, np.zeros(3)])
    gap = np.hypot(gap_ahead, gap_aside)
    if (highest - lowest)[:UPWARDS].min() > WIDEST_M or gap > MIN_RANGE_M:
        return ()  # Something beside the vehicle
    return tuple(np.concatenate([lowest, highest]).astype(np.float64).round(DIGITS).tolist())


def _cell_ranges(cells_of_scans: Sequence[_Cells]) -> _CellRanges:
    """Return the nearest range of each cell over all scans."""
    count = len(cells_of_scans)
    nearest = np.full((count, AZIMUTHS * ELEVATIONS), np.inf)
    for cells, ranges in zip(cells_of_scans, nearest, strict=True):
        np.minimum.at(ranges, cells.cell_of_point, cells.ranges)
    seen = np.isfinite(nearest).mean(axis=0)
    with np.errstate(invalid="ignore"):  # A cell without a point in any scan
        middle = (seen * count / 2).astype(int)
        median = np.sort(nearest, axis=0)[middle, np.arange(len(seen))]
        constant = (np.abs(nearest - median) < TOLERANCE_M).sum(axis=0) / (seen * count)
    return _CellRanges(median=median, seen=seen, constant=constant)


def _body_cells(cells: _CellRanges, least_z: float) -> Mask | None:
    """Return which cells (C,) see the body of the vehicle; None if none do, or if it stands."""
    with np.errstate(invalid="ignore"):  # An infinite median
        rises = cells.median * np.tile(np.sin(CENTRES), AZIMUTHS) > least_z
    is_seen = cells.seen >= SEEN
    is_far = is_seen & rises & (cells.median > FARTHEST_M)
    if not is_far.any() or (cells.constant[is_far] >= CONSTANT).mean() > MOVING:
        return None
    is_near = is_seen & rises & (cells.median <= FARTHEST_M)
    is_body: Mask = is_near & (cells.constant >= CONSTANT)
    return is_body if is_body.sum() >= MIN_CELLS else None


def _cells(points: Float) -> _Cells:
    """Return the cells and the ranges of points (N, 3)."""
    ranges, is_measured = measured_ranges(points)
    is_usable = is_measured & (ranges >= MIN_RANGE_M)
    x, y, z = np.where(is_usable[:, None], points, np.float32(1)).T
    around = (np.arctan2(y, x) / (2 * np.pi) + 0.5) * AZIMUTHS
    upwards = (np.arctan2(z, np.hypot(x, y)) / np.pi + 0.5) * ELEVATIONS
    cell_of_point = around.astype(np.intp) % AZIMUTHS * ELEVATIONS
    cell_of_point += upwards.astype(np.intp).clip(0, ELEVATIONS - 1)
    return _Cells(cell_of_point, np.where(is_usable, ranges, np.inf))
