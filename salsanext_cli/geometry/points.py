# SPDX-License-Identifier: MIT
"""Points of a scan: their ranges, a sample, the frame of their sensor, values of their pixels.

In the frame of the sensor, points are relative to its place, with z up, and without its vehicle.
"""

import sys
from dataclasses import replace
from functools import cache
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from salsanext_cli.records import Float, Int, Scan
from salsanext_cli.sensors.sensor import ORIGIN, UP, Sensor

Value = TypeVar("Value", bound=np.generic)


def points_from_pixels(
    of_pixels: npt.NDArray[Value], pixel_of_point: Int, empty: npt.ArrayLike
) -> npt.NDArray[Value]:
    """Give every point its pixel's value.

    `of_pixels` (H, W) or (C, H, W), values of the pixels, of any dtype; `pixel_of_point` (N,)
    int32, flat pixel index, -1 without a pixel; `empty`: value of the points without a pixel.

    Returns (N,) or (N, C), same dtype, a new array.
    """
    flat = of_pixels.reshape(*of_pixels.shape[:-2], -1)
    of_points: npt.NDArray[Value] = flat.T[pixel_of_point]
    of_points[pixel_of_point < 0] = empty
    return of_points


def pixels_from_points(
    of_points: npt.NDArray[Value], point_of_pixel: Int, empty: npt.ArrayLike = 0
) -> npt.NDArray[Value]:
    """Give every pixel its nearest point's value.

    `of_points` (N, …), values of the points, of any dtype; `point_of_pixel` (H, W) int32, index of
    the nearest point, -1 where a pixel is empty; `empty`: value of the empty pixels.

    Returns (H, W, …), same dtype, a new array.
    """
    # Index -1 finds the value that is appended.
    last = np.full((1, *of_points.shape[1:]), empty, of_points.dtype)
    of_pixels: npt.NDArray[Value] = np.concatenate([of_points, last])[point_of_pixel]
    return of_pixels


MAX_POINTS = 4096
LARGEST = np.float32(1e6)
"""Largest range in metres, and largest intensity, that counts as a measurement of a range image."""


def measured_ranges(
    points: Float, farthest: float = sys.float_info.max
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.bool_]]:
    """Return the range of every point, and whether the point holds a measurement.

    `points` (N, 3) float32, Cartesian coordinates in metres, sensor frame; `farthest`: largest
    range in metres that is a measurement; any finite one if not given.

    Returns `ranges` (N,) float64, distances from the sensor in metres; `measured` (N,) bool, false
    for the origin, NaN, infinity and ranges beyond the farthest.
    """
    with np.errstate(invalid="ignore"):  # of a signalling NaN
        x, y, z = np.square(points.T, dtype=np.float64)
        ranges = np.sqrt(x + y + z)
    return ranges, (ranges > 0) & (ranges <= farthest)


def few_points(scan: Scan, count: int = MAX_POINTS) -> Scan:
    """Return a number of points of a scan in their order, drawn alike; all if there are no more.

    Of points in the order of a grid, every n-th could be of few beams or in few directions.
    """
    if len(scan) <= count:
        return scan
    places = drawn(len(scan), count)
    return Scan(scan.points[places], scan.intensity[places])


def drawn(length: int, count: int) -> npt.NDArray[np.intp]:
    """Return places in an array of a length, rising, drawn alike; all if there are no more.

    Returns (count,) or (length,) intp.
    """
    return np.arange(length) if length <= count else (_uniform(count) * length).astype(np.intp)


@cache
def _uniform(count: int) -> npt.NDArray[np.float64]:
    return np.sort(np.random.default_rng(0).random(count))


def in_sensor_frame(scan: Scan, sensor: Sensor) -> Scan:
    """Return the scan moved from the sensor's `origin`, and turned so that its `up` is the z axis.

    Itself if it is so already. Points at the origin of the files are no measurements and stay none.
    """
    points = scan.points
    if sensor.origin != ORIGIN:
        points = points - np.array(sensor.origin, np.float32)
        points[~scan.points.any(axis=1)] = 0
    if sensor.up != UP:
        x, y, z = points.T.astype(np.float64)
        # A matrix product would leave threads behind that take the processors from the network.
        rows = [a * x + b * y + c * z for a, b, c in upright_rotation(np.asarray(sensor.up))]
        points = np.stack(rows, axis=1).astype(np.float32)
    return scan if points is scan.points else replace(scan, points=points)


def without_ego(scan: Scan, sensor: Sensor) -> Scan:
    """Return the scan in the sensor's frame, with the points of its vehicle at the origin.

    There they are no measurements; which they are, `ego_points` says.
    """
    scan = in_sensor_frame(scan, sensor)
    own = ego_points(scan.points, sensor)
    if not len(own):
        return scan
    points = scan.points.copy()
    points[own] = 0
    return replace(scan, points=points)


def ego_points(points: Float, sensor: Sensor) -> npt.NDArray[np.intp]:
    """Return the indices of points nearer than `min_range`, or in `ego_box`, of their sensor.

    `points` (N, 3) float32, metres, in the frame of the sensor, upright. Those at its origin are
    none either way.
    """
    nearest, box = sensor.min_range or 0.0, np.array(sensor.ego_box or ()).reshape(2, -1)
    reach = max(nearest, float(np.linalg.norm(np.abs(box).max(axis=0, initial=0))))
    if not reach:
        return np.empty(0, np.intp)
    squares = np.einsum("nk,nk->n", points, points)
    near = np.flatnonzero((squares < np.float32(reach) ** 2) & (squares > 0))
    own = squares[near] < np.float32(nearest) ** 2
    if box.size:
        own |= ((points[near] >= box[0]) & (points[near] <= box[1])).all(axis=1)
    found: npt.NDArray[np.intp] = near[own]
    return found


def upright_rotation(up: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return the rotation that turns a direction (3,) to z and the direction ahead to x, (3, 3).

    Ahead is x, or what of it is level; in frames of cameras, with y down, and in those with x up or
    down, it is z.
    """
    up = up / np.linalg.norm(up)
    largest = int(np.abs(up).argmax())
    ahead = np.eye(3)[2 if largest == 0 or (largest == 1 and up[1] < 0) else 0]
    level = ahead - (ahead @ up) * up
    level /= np.linalg.norm(level)
    return np.stack([level, np.cross(up, level), up])
