# SPDX-License-Identifier: MIT
"""Scans in the frame of their sensor: at its origin, with z up, without its own vehicle."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from salsanext_cli.records import Float, Scan
from salsanext_cli.sensors.sensor import ORIGIN, UP, Sensor


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
