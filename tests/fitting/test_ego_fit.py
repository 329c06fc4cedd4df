# SPDX-License-Identifier: MIT
"""The box around a vehicle, against scans whose rays are told which of them meet it."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scans import SMALL

from salsanext_cli import Scan, read_labels, read_scan
from salsanext_cli.fitting.scan_fit import MAX_SCANS
from salsanext_cli.fitting.view_fit import MIN_RANGE_M, fit_ego
from salsanext_cli.geometry.projection import ego_points, without_ego
from salsanext_cli.results.selection import evenly_spaced

ROOF = np.array([[-1.8, -0.7, -0.9], [0.6, 0.7, -0.4]])
NEIGHBOUR = np.array([[-1.0, 1.8, -1.3], [1.0, 2.4, 0.3]])
HEIGHT = 1.8


def rays() -> np.ndarray:
    azimuth, elevation = np.meshgrid(np.radians(np.arange(360)), np.radians(np.arange(-40, 8)))
    flat = np.cos(elevation)
    xyz = (flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation))
    return np.stack(xyz, axis=-1).reshape(-1, 3)


def hits(box: np.ndarray) -> np.ndarray:
    """Return the ranges at which rays meet a box, infinite for those that miss it."""
    with np.errstate(divide="ignore", invalid="ignore"):
        planes = box[:, None] / rays()
    entry, end = planes.min(axis=0).max(axis=1), planes.max(axis=0).min(axis=1)
    return np.where((entry < end) & (entry > 0), entry, np.inf)


def driven(
    count: int, *, moving: bool = True, beside: int = 0, roof: bool = True, height: float = HEIGHT
) -> list[Scan]:
    """Return scans of a flat place with a roof below the sensor, some with a car beside it."""
    scans = []
    with np.errstate(divide="ignore"):
        ground = np.where(rays()[:, 2] < 0, -height / rays()[:, 2], np.inf)
    for seed in range(count):
        random = np.random.default_rng(seed if moving else 0)
        others = random.uniform(4, 40, len(ground))
        ranges = np.minimum(ground, others)
        if roof:
            ranges = np.minimum(ranges, hits(ROOF))
        if seed < beside:
            ranges = np.minimum(ranges, hits(NEIGHBOUR))
        ranges = ranges + np.random.default_rng(seed).normal(0, 0.01, len(ranges))
        points = (rays() * ranges[:, None]).astype(np.float32)
        scans.append(Scan(points, random.random(len(points), np.float32)))
    return scans


@pytest.mark.parametrize("beside", [0, 5])
def test_the_box_holds_the_roof_and_little_more(beside):
    scans = driven(8, beside=beside)
    box = fit_ego(scans, SMALL).ego_box
    met = np.isfinite(hits(ROOF))
    met &= hits(ROOF) > MIN_RANGE_M
    own = ego_points(scans[7].points, replace(SMALL, ego_box=box))
    assert np.isin(np.flatnonzero(met), own).mean() > 0.95
    assert np.isin(own, np.flatnonzero(np.isfinite(hits(ROOF)))).mean() > 0.99
    lowest, highest = np.array(box).reshape(2, 3)
    assert (lowest > ROOF[0] - 0.3).all()
    assert (highest < ROOF[1] + 0.3).all()


@pytest.mark.parametrize(
    "scans",
    [
        driven(2),
        driven(8, moving=False),
        [scan.take(np.flatnonzero(scan.points[:, 2] > -1)) for scan in driven(8)],
        driven(8, beside=8, roof=False),
    ],
    ids=["two scans", "vehicle that stands", "no ground", "another beside it all the way"],
)
def test_scans_that_do_not_tell_a_box(scans):
    assert fit_ego(scans, SMALL).ego_box == ()


@pytest.mark.parametrize("height", [0.4, 0.9])
def test_a_low_sensor_keeps_its_floor(height):
    scans = driven(2, roof=False, height=height)
    found = fit_ego(scans, SMALL)
    assert found.min_range == pytest.approx(0.8 * height, abs=0.05)
    assert not len(ego_points(scans[0].points, found))


@given(
    arrays.arrays(np.float32, (30, 3), elements=st.floats(-3, 3, width=32)),
    st.floats(0, 2),
    st.booleans(),
)
def test_points_of_the_vehicle_by_a_plain_loop(points, nearest, boxed):
    sensor = replace(SMALL, min_range=nearest, ego_box=tuple(ROOF.ravel()) if boxed else ())
    expected = []
    for i, point in enumerate(points):
        squared = np.einsum("k,k", point, point)
        near = 0 < squared < np.float32(nearest) ** 2
        inside = boxed and bool((point >= ROOF[0]).all() and (point <= ROOF[1]).all())
        if near or (inside and squared > 0):
            expected.append(i)
    assert ego_points(points, sensor).tolist() == expected
    scan = without_ego(Scan(points, np.zeros(30, np.float32)), sensor)
    kept = np.delete(np.arange(30), expected)
    assert (scan.points[kept] == points[kept]).all()
    assert not scan.points[expected].any()


@pytest.mark.real
@pytest.mark.parametrize("drive", ["0001", "0004"])
def test_the_vehicle_of_real_drives_is_left_out(real_data, drive):
    """By their labels: 31 is the vehicle itself."""
    files = sorted((real_data / f"data/drives/sequences/{drive}/velodyne").glob("*.bin"))
    files = evenly_spaced(files, MAX_SCANS)
    scans = [read_scan(file) for file in files]
    sensor = fit_ego(scans, SMALL)
    truth = [read_labels(file.parents[1] / "labels" / f"{file.stem}.label") for file in files]
    own = np.concatenate([np.isin(np.arange(len(s)), ego_points(s.points, sensor)) for s in scans])
    vehicle = np.concatenate(truth) == 31
    assert own[vehicle].mean() > 0.98
    assert own[~vehicle].mean() < 0.001
