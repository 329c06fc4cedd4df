# SPDX-License-Identifier: MIT
import math
from dataclasses import replace

import numpy as np
import pytest
from scans import SMALL, make_scan
from slow_geometry import slow_project

from salsanext_cli import Scan, project
from salsanext_cli.geometry.projection import rows_of

BEAMS = (10.0, 3.0, 2.0, 1.5, -7.0, -25.0)


def slow_rows(scan, sensor):
    """Compare every point with every beam."""
    rows = []
    for x, y, z in scan.points.tolist():
        elevation = math.degrees(math.atan2(z, math.hypot(x, y)))
        beam = min(range(len(sensor.beams)), key=lambda b: abs(sensor.beams[b] - elevation))
        rows.append(math.floor((beam + 0.5) * sensor.height / len(sensor.beams)))
    return rows


def of_beams(elevations, per_beam=50, ring=None, tilt=0.0):
    """Points of each elevation in degrees all around, at any range; their rings are given."""
    random = np.random.default_rng(1)
    azimuth = np.tile(np.linspace(-np.pi, np.pi, per_beam, endpoint=False), len(elevations))
    elevation = np.radians(np.repeat(elevations, per_beam) + tilt * np.sin(azimuth))
    distance = random.uniform(3, 40, len(azimuth))
    flat = distance * np.cos(elevation)
    points = (flat * np.cos(azimuth), flat * np.sin(azimuth), distance * np.sin(elevation))
    rings = None if ring is None else np.repeat(ring, per_beam).astype(np.int32)
    points = np.stack(points, 1).astype(np.float32)
    return Scan(points, random.random(len(points), np.float32), rings)


@pytest.mark.parametrize("height", [1, 4, 6, 16, 64])
def test_rows_are_those_of_the_nearest_beam(height):
    seen = replace(SMALL, beams=BEAMS, height=height)
    scan = make_scan(2000)
    np.testing.assert_array_equal(rows_of(scan, seen), slow_rows(scan, seen))
    assert rows_of(scan, SMALL) is None


def test_rings_tell_beams_in_any_order_of_their_numbers():
    ring = np.array([4, 0, 9, 1, 7, 2])
    seen = replace(SMALL, beams=BEAMS, height=6)
    # Half the points are nearer to another beam.
    scan = of_beams(BEAMS, 400, ring, tilt=0.4)
    expected = np.repeat(np.arange(6), 400)
    np.testing.assert_array_equal(rows_of(scan, seen), expected)
    assert (rows_of(replace(scan, ring=None), seen) != expected).any()
    unknown = replace(scan, ring=np.full(len(scan), -1, np.int32))
    np.testing.assert_array_equal(rows_of(unknown, seen), rows_of(replace(scan, ring=None), seen))


def test_points_without_a_measurement_do_not_count():
    seen = replace(SMALL, beams=BEAMS, height=6)
    scan = of_beams(BEAMS, 40, np.arange(6))
    points = scan.points.copy()
    points[::3] = np.nan
    points[1::3] = 0
    broken = replace(scan, points=points)
    np.testing.assert_array_equal(rows_of(broken, seen)[2::3], rows_of(scan, seen)[2::3])
    image = project(broken, seen)
    assert ((image.pixel_of_point >= 0) == (np.arange(len(scan)) % 3 == 2)).all()
    nothing = Scan(np.zeros((0, 3), np.float32), np.zeros(0, np.float32), np.zeros(0, np.int32))
    assert len(rows_of(nothing, seen)) == 0
    assert not project(nothing, seen).channels.any()


@pytest.mark.parametrize("out_of_view", ["clamp", "drop"])
def test_a_projection_by_beams_differs_in_rows_only(rings, out_of_view):
    seen = replace(SMALL, beams=tuple(np.linspace(4, -26, 40).tolist()), height=40, fov_down=-20)
    seen = replace(seen, out_of_view=out_of_view)
    image = project(rings, seen)
    _, spherical, _, slow_range = slow_project(rings, replace(seen, beams=()))
    expected = np.where(spherical >= 0, rows_of(rings, seen) * 128 + spherical % 128, -1)
    np.testing.assert_array_equal(image.pixel_of_point, expected)
    np.testing.assert_array_equal(image.point_range, slow_range)
    nearest = np.full(image.point_of_pixel.size, np.inf, np.float32)
    np.minimum.at(nearest, expected[expected >= 0], slow_range[expected >= 0])
    np.testing.assert_array_equal(image.channels[0].ravel(), np.where(nearest < np.inf, nearest, 0))
