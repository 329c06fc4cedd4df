# SPDX-License-Identifier: MIT
"""Scans in the frame of their sensor: at its origin, with z up."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from salsanext_cli.records import Scan
from salsanext_cli.sensors import ORIGIN, UP, Sensor


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
