# SPDX-License-Identifier: MIT
"""Scans of sensors that are not mounted upright."""

import numpy as np
import numpy.typing as npt

from salsanext_cli.records import Scan
from salsanext_cli.sensors import UP, Sensor


def upright(scan: Scan, sensor: Sensor) -> Scan:
    """Return the scan turned so that the sensor's `up` is the z axis; itself if it is already."""
    if sensor.up == UP:
        return scan
    x, y, z = scan.points.T.astype(np.float64)
    # A matrix product would leave threads behind that take the processors from the network.
    rows = [a * x + b * y + c * z for a, b, c in rotation_to_z(np.asarray(sensor.up))]
    return Scan(np.stack(rows, axis=1).astype(np.float32), scan.intensity)


def rotation_to_z(up: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return the rotation by the least angle that turns a direction (3,) to z, (3, 3).

    Upside down, where many are least, it is the half turn about x.
    """
    x, y, z = up / np.linalg.norm(up)
    across = x * x + y * y
    if z < 0 and across < 1e-24:
        return np.diag([1.0, -1.0, -1.0])
    # Rodrigues' formula for the axis up × z, of length sin, and the angle of cosine z.
    cross = np.array([[0, 0, -x], [0, 0, -y], [x, y, 0]])
    # Of a direction far down 1 + z would cancel.
    one_plus_z = across / (1 - z) if z < 0 else 1 + z
    rotation: npt.NDArray[np.float64] = np.eye(3) + cross + cross @ cross / one_plus_z
    return rotation
