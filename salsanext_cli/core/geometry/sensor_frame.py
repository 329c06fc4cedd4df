# SPDX-License-Identifier: MIT
"""Scans in the frame of their sensor, which has its origin at the sensor and z up."""

from dataclasses import replace

import numpy as np

from salsanext_cli.core.records import Double, Float, Indices, Scan
from salsanext_cli.core.sensors.sensor import ORIGIN, UP, Sensor


def in_sensor_frame(scan: Scan, sensor: Sensor) -> Scan:
    """Return the scan with the `origin` of the sensor at 0 and its `up` along z."""
    points = scan.points
    if sensor.origin != ORIGIN:
        points = points - np.array(sensor.origin, np.float32)
        points[~scan.points.any(axis=1)] = 0
    if sensor.up != UP:
        x, y, z = points.T.astype(np.float64)
        # The threads of a matrix product would take the processors from the network.
        rows = [a * x + b * y + c * z for a, b, c in upright_rotation(np.asarray(sensor.up))]
        points = np.stack(rows, axis=1).astype(np.float32)
    return scan if points is scan.points else replace(scan, points=points)


def around(points: Double | Float, origin: Double) -> Double:
    """Return points (N, 3) around an origin (3,), in metres.

    Points at 0 are no measurements, and stay.
    """
    is_measured = (points != 0).any(axis=1, keepdims=True)
    # In float64, because the numbers of a map are large.
    moved: Double = np.where(is_measured, points - origin.astype(np.float64), 0)
    return moved


def without_ego(scan: Scan, sensor: Sensor) -> Scan:
    """Return the scan in the frame of the sensor, with the points of its vehicle at the origin."""
    scan = in_sensor_frame(scan, sensor)
    ego = ego_points(scan.points, sensor)
    if not len(ego):
        return scan
    points = scan.points.copy()
    points[ego] = 0
    return replace(scan, points=points)


def ego_points(points: Float, sensor: Sensor) -> Indices:
    """Return the indices of points (N, 3) in the frame of the sensor, on it or its vehicle."""
    nearest = sensor.min_range or 0.0
    box = np.array(sensor.ego_box or ()).reshape(2, -1)
    reach = max(nearest, float(np.linalg.norm(np.abs(box).max(axis=0, initial=0))))
    if not reach:
        return np.empty(0, np.intp)
    squares = np.einsum("nk,nk->n", points, points)
    near = np.flatnonzero((squares < np.float32(reach) ** 2) & (squares > 0))
    is_ego = squares[near] < np.float32(nearest) ** 2
    if box.size:
        is_ego |= ((points[near] >= box[0]) & (points[near] <= box[1])).all(axis=1)
    return near[is_ego]


def upright_rotation(up: Double) -> Double:
    """Return the rotation (3, 3) that turns a direction (3,) to z and the direction ahead to x.

    Ahead is the level part of x, or of z in the frame of a camera, with y down or x vertical.
    """
    up = up / np.linalg.norm(up)
    largest = int(np.abs(up).argmax())
    ahead = np.eye(3)[2 if largest == 0 or (largest == 1 and up[1] < 0) else 0]
    level = ahead - (ahead @ up) * up
    level /= np.linalg.norm(level)
    return np.stack([level, np.cross(up, level), up])
