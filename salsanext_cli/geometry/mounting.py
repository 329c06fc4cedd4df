# SPDX-License-Identifier: MIT
"""Scans of sensors that are not mounted upright."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from salsanext_cli.records import Scan
from salsanext_cli.sensors import UP, Sensor


def upright(scan: Scan, sensor: Sensor) -> Scan:
    """Return the scan turned so that the sensor's `up` is the z axis; itself if it is already."""
    if sensor.up == UP:
        return scan
    points = (scan.points @ rotation_to_z(np.asarray(sensor.up)).T).astype(np.float32)
    return replace(scan, points=points)


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
