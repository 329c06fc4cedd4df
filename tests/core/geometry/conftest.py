# SPDX-License-Identifier: MIT
"""Scans that more than one geometry test needs."""

import numpy as np
import pytest

from salsanext_cli import Scan, project, read_scan, sensor


@pytest.fixture(scope="session")
def rings():
    """40 000 points on 40 rings around the sensor: more than one slice of work."""
    random = np.random.default_rng(7)
    elevation = np.repeat(np.radians(np.linspace(4, -26, 40)), 1000)
    azimuth = np.tile(np.linspace(-np.pi, np.pi, 1000), 40)
    distance = random.uniform(2, 80, 40000)
    flat = distance * np.cos(elevation)
    points = (flat * np.cos(azimuth), flat * np.sin(azimuth), distance * np.sin(elevation))
    points = np.stack(points, axis=1).astype(np.float32)
    points[::500] = 0
    points[::777, 1] = np.nan
    return Scan(points, random.random(40000, np.float32))


@pytest.fixture(scope="session")
def real_scan(real_data):
    return read_scan(real_data / "data/semantickitti/sequences/08/velodyne/000000.bin")


@pytest.fixture(scope="session")
def real_image(real_scan):
    return project(real_scan, sensor("hdl64"))
