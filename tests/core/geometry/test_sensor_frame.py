# SPDX-License-Identifier: MIT
"""The frame of a sensor is that of the file, moved and turned, without points of its vehicle."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scans import SMALL, make_scan

from salsanext_cli.core.geometry.sensor_frame import (
    ego_points,
    in_sensor_frame,
    upright_rotation,
    without_ego,
)


def test_the_origin_of_the_sensor_moves_to_zero():
    scan = make_scan()
    origin = (1.0, -2.0, 0.5)
    points = in_sensor_frame(scan, replace(SMALL, origin=origin)).points
    for moved, point in zip(points, scan.points, strict=True):
        expected = [float(point[axis]) - origin[axis] if point.any() else 0.0 for axis in range(3)]
        assert moved == pytest.approx(expected, abs=1e-4)


def test_a_scan_in_the_frame_of_its_sensor_is_itself():
    scan = make_scan()
    assert in_sensor_frame(scan, SMALL) is scan


@pytest.mark.parametrize("up", [(0.0, 0.0, 1.0), (0.0, -1.0, 0.0), (0.3, 0.2, -0.9), (1.0, 0, 0)])
def test_the_rotation_turns_up_to_z_and_keeps_distances(up):
    rotation = upright_rotation(np.array(up))
    length = math.hypot(*up)
    assert rotation @ np.array(up) == pytest.approx([0, 0, length])
    assert rotation @ rotation.T == pytest.approx(np.eye(3))
    assert np.linalg.det(rotation) == pytest.approx(1)
    scan = make_scan()
    turned = in_sensor_frame(scan, replace(SMALL, up=up)).points
    for point, other in zip(scan.points[:50], turned, strict=False):
        expected = [sum(row[axis] * float(point[axis]) for axis in range(3)) for row in rotation]
        assert other == pytest.approx(expected, abs=1e-3)


def test_points_of_the_vehicle_are_those_in_the_box_or_too_near():
    points = np.array([[0, 0, 0], [0.5, 0, 0], [2, 0.5, -1], [2, 0.5, 1], [3, 0, 0]], np.float32)
    sensor = replace(SMALL, min_range=1.0, ego_box=(-1.0, -1.0, -2.0, 2.5, 1.0, 0.0))
    assert ego_points(points, sensor).tolist() == [1, 2]
    assert ego_points(points, replace(sensor, min_range=0.0, ego_box=())).tolist() == []
    scan = make_scan().take(np.arange(5))
    scan = replace(scan, points=points)
    expected = points.copy()
    expected[[1, 2]] = 0
    assert np.array_equal(without_ego(scan, sensor).points, expected)
    assert np.array_equal(scan.points, points)
