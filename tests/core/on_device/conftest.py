# SPDX-License-Identifier: MIT
"""Scans and sensors whose batches are computed on each device."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from scans import SMALL, make_scan, real_scans

from salsanext_cli import Scan, Sensor, read_scan, sensor
from salsanext_cli.core.on_device.host_points import HostPoints
from salsanext_cli.core.on_device.scan_batch import ScanBatch

Batches = Callable[[Sequence[Scan], Sequence[Sensor]], ScanBatch]
SPECIAL = np.float32([0, -0.0, 1, -1, 2, 1e-40, 1e30, -3e38, np.nan, np.inf, -np.inf])


def lattice(count: int, seed: int) -> Scan:
    """Return points of few coordinates: equal ones, equal ranges, borders of pixels, no numbers."""
    random = np.random.default_rng(seed)
    points = random.integers(-3, 4, (count, 3)).astype(np.float32)
    special = random.random((count, 3)) < 0.1
    points[special] = random.choice(SPECIAL, special.sum())
    intensity = random.random(count, np.float32)
    intensity[::7] = random.choice(SPECIAL, len(intensity[::7]))
    return Scan(points, intensity)


@pytest.fixture(scope="session")
def scans() -> list[Scan]:
    """Return scans of several sizes, one of them empty."""
    empty = Scan(np.empty((0, 3), np.float32), np.empty(0, np.float32))
    return [make_scan(3000), lattice(4000, 1), empty, make_scan(500, 3), lattice(1000, 2)]


@pytest.fixture(scope="session")
def sensors() -> list[Sensor]:
    """Return members of one size: plain, dropping, moved, tilted with a box, with near points."""
    return [
        SMALL,
        replace(SMALL, fov_up=10.0, fov_down=-10.0, out_of_view="drop"),
        replace(SMALL, origin=(1.0, 0.0, 0.5)),
        replace(SMALL, up=(0.1, -0.2, 1.0), ego_box=(-7.0, -6.0, -3.0, 7.0, 6.0, 1.0)),
        replace(SMALL, origin=(0.0, 1.0, 0.0), min_range=2.5),
    ]


@pytest.fixture
def batch_of(device: str) -> Batches:
    """Return the function that copies scans with their sensors to the device of the test."""

    def copy(scans: Sequence[Scan], sensors: Sequence[Sensor]) -> ScanBatch:
        points = [HostPoints.from_scan(scan, device) for scan in scans]
        return ScanBatch.on_device(points, sensors, device)

    return copy


@pytest.fixture(scope="session")
def hdl64_scans(real_data) -> list[Scan]:
    """Return real scans of an HDL-64."""
    paths = [path for path in real_scans(real_data) if "semantickitti" in path.parts]
    assert len(paths) >= 3
    return [read_scan(path, sensor("hdl64")) for path in paths[:3]]
