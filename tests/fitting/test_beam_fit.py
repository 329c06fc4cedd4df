# SPDX-License-Identifier: MIT
from dataclasses import replace

import numpy as np
import pytest
from scans import SMALL

from salsanext_cli import Scan, read_scan
from salsanext_cli.fitting.view_fit import fit_beams

EVEN = np.linspace(15, -15, 16)
FINE = np.linspace(22.5, -22.5, 128)
UNEVEN = np.array([15, 11, 8, 5, 3, 2, 1.67, 1.33, 1, 0.67, 0.33, 0, -0.33, -6, -7, -13, -25])


def of_beams(elevations, noise, seed=0, ring=False):
    """Return a scan of beams whose elevations have some noise in degrees."""
    random = np.random.default_rng(seed)
    count = 600 * len(elevations)
    beam = random.integers(0, len(elevations), count)
    elevation = np.radians(elevations[beam] + random.normal(0, noise, count))
    azimuth, distance = random.uniform(-np.pi, np.pi, count), random.uniform(2, 60, count)
    flat = distance * np.cos(elevation)
    points = (flat * np.cos(azimuth), flat * np.sin(azimuth), distance * np.sin(elevation))
    points = np.stack(points, 1).astype(np.float32)
    intensity = np.zeros(count, np.float32)
    return Scan(points, intensity, beam.astype(np.int32) if ring else None)


@pytest.mark.parametrize(("beams", "noise"), [(EVEN, 0.1), (FINE, 0.03), (UNEVEN, 0.02)])
def test_discernible_beams_are_found(beams, noise):
    found = fit_beams([of_beams(beams, noise, seed) for seed in range(2)], SMALL)
    assert len(found) == len(beams)
    np.testing.assert_allclose(found, beams, atol=0.06)


@pytest.mark.parametrize("noise", [0.01, 0.3])
def test_rings_tell_beams_that_are_not_discernible(noise):
    scans = [of_beams(UNEVEN, noise, seed, ring=True) for seed in range(2)]
    np.testing.assert_allclose(fit_beams(scans, SMALL), UNEVEN, atol=0.05)


@pytest.mark.parametrize("up", [(0.0, 0.0, -1.0), (0.0, 1.0, 0.0)])
def test_beams_are_those_of_the_upright_sensor(up):
    upright = of_beams(UNEVEN, 0.02)
    x, y, z = upright.points.T
    points = (x, -y, -z) if up[2] else (x, z, -y)
    turned = replace(upright, points=np.stack(points, 1).astype(np.float32))
    np.testing.assert_allclose(fit_beams([turned], replace(SMALL, up=up)), UNEVEN, atol=0.06)


def test_a_ring_that_is_something_else_does_not_count():
    scan = of_beams(EVEN, 0.02)
    wrong = np.random.default_rng(0).integers(0, 16, len(scan)).astype(np.int32)
    found = fit_beams([replace(scan, ring=wrong)], SMALL)
    np.testing.assert_allclose(found, EVEN, atol=0.06)
    unknown = np.full(len(scan), -1, np.int32)
    np.testing.assert_allclose(fit_beams([replace(scan, ring=unknown)], SMALL), EVEN, atol=0.06)


@pytest.mark.parametrize(
    ("name", "count"),
    [
        ("nuscenes_hdl32/five_columns.pcd.bin", 32),
        ("nuscenes_hdl32/four_columns/velodyne/000000.bin", 32),
        ("ouster/os1_128.bin", 128),
        ("ouster/os2_32.bin", 32),
        ("pcd/os1_ascii_half_zeros.pcd", 64),
        ("pcd/ring40_padding_fields.pcd", 40),
        ("pcd/hdl32_with_points_at_origin.pcd", 32),
        ("pcd/hdl64.pcd", 0),
        ("pcd/livox_front.pcd", 0),
    ],
)
def test_beams_of_real_sensors(real_data, name, count):
    scan = read_scan(real_data / "data/sensors" / name)
    assert len(fit_beams([scan], SMALL)) == count
