# SPDX-License-Identifier: MIT
"""Scans in the frame of their sensor: at its origin, with z up."""

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
        points = (points @ rotation_to_z(np.asarray(sensor.up)).T).astype(np.float32)
    return scan if points is scan.points else Scan(points, scan.intensity)


def rotation_to_z(up: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return the rotation by the least angle that turns a direction (3,) to z, (3, 3).

    Upside down, where many are least, it is the half turn about x.
    """
    x, y, z = up / np.linalg.norm(up)
    if z < -1 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    # Rodrigues' formula for the axis up × z, of length sin, and the angle of cosine z.
    cross = np.array([[0, 0, -x], [0, 0, -y], [x, y, 0]])
    rotation: npt.NDArray[np.float64] = np.eye(3) + cross + cross @ cross / (1 + z)
    return rotation
