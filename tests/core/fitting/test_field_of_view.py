# SPDX-License-Identifier: MIT
"""Field of view and vehicle, fitted to scans with known rays."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from calls import calls_of
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scans import SMALL, make_scan

from salsanext_cli import Scan, project, read_labels, read_scan
from salsanext_cli.core.checks.scan_checks import check_scan, share_outside
from salsanext_cli.core.fitting.ego_fit import MIN_RANGE_M, fit_ego
from salsanext_cli.core.fitting.field_of_view import SHOWN, fit_view
from salsanext_cli.core.geometry.sensor_frame import ego_points, upright_rotation, without_ego
from salsanext_cli.runs.fit import sensor_fit
from salsanext_cli.runs.fit.scan_sample import MAX_SCANS, sample_of_files
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.runs.scans.selection import evenly_spaced

SCANS = [make_scan(3000, seed) for seed in range(3)]

KNOWN_EGO = replace(SMALL, min_range=0.0, ego_box=())
"""Its vehicle is known, so that only the field of view is fitted."""


def outside(scan, sensor):
    """Return the share of the points of a scan outside of a view."""
    return share_outside(scan.points[:, 2] / np.linalg.norm(scan.points, axis=1), sensor)


def turned(scan, up):
    points = scan.points @ upright_rotation(np.asarray(up, float))
    return Scan(points.astype(np.float32), scan.intensity)


def test_a_matching_field_of_view_and_the_image_stay_and_another_view_is_fitted():
    assert fit_view(SCANS, KNOWN_EGO) == KNOWN_EGO
    nearly = replace(KNOWN_EGO, fov_up=1.0)
    assert fit_view(SCANS, nearly) == nearly
    above = replace(KNOWN_EGO, fov_up=25.0, fov_down=-7.0)
    found = fit_view(SCANS, above)
    assert (found.fov_up, found.fov_down) == pytest.approx((3, -25), abs=0.3)
    shares = [outside(scan, found) for scan in SCANS]
    assert max(shares) < 0.01
    assert replace(found, name="small", fov_up=25.0, fov_down=-7.0) == above


@pytest.mark.parametrize("out_of_view", ["clamp", "drop"])
def test_points_above_and_below_the_field_of_view_are_counted(out_of_view):
    elevations = np.array([-90, -60, -25.1, -24.9, 0, 2.9, 3.1, 89])
    sensor = replace(SMALL, out_of_view=out_of_view)
    assert share_outside(np.sin(np.radians(elevations)), sensor) == 5 / 8
    assert share_outside(np.empty(0), sensor) == 0


@pytest.mark.parametrize("extent", [5.0, 15.0, 22.0])
def test_the_field_of_view_is_no_larger_than_most_points_need(extent):
    """Else objects would be lower in the image than in training."""
    found = fit_view(SCANS, replace(SMALL, fov_up=30.0 + extent, fov_down=30.0))
    points = np.concatenate([scan.points for scan in SCANS])
    elevations = np.sort(np.degrees(np.arcsin(points[:, 2] / np.linalg.norm(points, axis=1))))
    count = round(SHOWN * len(elevations))
    narrowest = min(b - a for a, b in zip(elevations, elevations[count - 1 :], strict=False))
    assert found.fov_up - found.fov_down == pytest.approx(max(narrowest, extent), abs=0.1)
    shares = [outside(scan, found) for scan in SCANS]
    assert np.mean(shares) < 1 - SHOWN + 0.01


@pytest.mark.parametrize(("lowest", "highest"), [(20, 45), (-80, -30), (-20, 85)])
def test_a_field_of_view_that_no_rotating_sensor_has_is_not_fitted(lowest, highest):
    """As of an accumulated cloud; the warning stays."""
    random = np.random.default_rng(0)
    azimuth, elevation = random.uniform(-180, 180, 4000), random.uniform(lowest, highest, 4000)
    around, upwards = np.radians([azimuth, elevation])
    flat = np.cos(upwards)
    points = np.stack([flat * np.cos(around), flat * np.sin(around), np.sin(upwards)], axis=1)
    points = (points * random.uniform(5, 30, (4000, 1))).astype(np.float32)
    scan = Scan(points, random.random(4000, np.float32))
    found = fit_view([scan], SMALL)
    assert (found.fov_up, found.fov_down, found.origin) == (3, -25, (0, 0, 0))
    assert "out-of-view" in [f.code for f in check_scan(Path("s.bin"), scan, found, SMALL).findings]


@pytest.mark.real
@pytest.mark.parametrize("name", ["csv/car_cloud400.csv", "indoor/pandar64_hall"])
def test_reported_scans_keep_the_view_of_the_weights(real_data, name):
    (file,) = find_scans(real_data / "data/reported" / name)
    scan = read_scan(file.path)
    found = fit_view([scan], SMALL)
    assert (found.fov_up, found.fov_down, found.origin) == (3, -25, (0, 0, 0))
    assert check_scan(file.path, scan, found, SMALL).findings


@pytest.mark.parametrize("up", [(0, 0, -1), (0, 1, 0), (-1, 0, 0), (0, 0.6, 0.8), (0.25, 0, 0.97)])
def test_images_of_sensors_that_lie_or_hang(up):
    """The same but for the direction that is ahead, which nothing tells."""
    scans = [turned(scan, up) for scan in SCANS]
    found = fit_view(scans, SMALL)
    assert np.dot(found.up, up) > 0.995
    assert (found.fov_up, found.fov_down) == (SMALL.fov_up, SMALL.fov_down)
    for scan, upright in zip(scans, SCANS, strict=True):
        image, expected = project(scan, found), project(upright, SMALL)
        assert (image.channels[0] > 0).mean() > 0.9 * (expected.channels[0] > 0).mean()
        z = [each.channels[3][each.channels[0] > 0] for each in (image, expected)]
        assert np.quantile(z[0], 0.1) == pytest.approx(np.quantile(z[1], 0.1), abs=0.1)


@pytest.mark.parametrize("height", [0.3, 0.6, 0.9, 1.5])
def test_a_sensor_in_a_room_stands_upright_where_its_beams_come_from(height):
    """A wide view sees the ceiling; near the floor no more than a part of that."""
    seen = rays(np.arange(0, 360, 0.5), np.linspace(-45, 45, 128))
    walls = np.array([[-3.2, -2.3, -height], [4.8, 2.7, 2.6 - height]])
    with np.errstate(divide="ignore"):
        ranges = (walls[:, None] / seen).max(axis=0).min(axis=1)
    ranges = ranges + np.random.default_rng(0).normal(0, 0.01, len(ranges))
    points = (seen * ranges[:, None]).astype(np.float32)
    found = fit_view([Scan(points, np.zeros(len(points), np.float32))], SMALL)
    assert (found.up, found.origin) == (SMALL.up, SMALL.origin)
    assert -46 < found.fov_down < found.fov_up < 46


def test_each_scan_is_read_once_for_view_intensity_and_gaps(world):
    settings = NetworkSettings(device="cpu", engine="torch")
    network = settings.load()
    sample = sample_of_files(find_scans(world.data), network.sensor)
    with calls_of(read_scan) as reads:
        network = sensor_fit.fit_scans(settings, network, sample)
        assert len(sample.images(network.sensor)) == len(reads)
    assert network.sensor.intensity_quantiles
    assert network.sensor.row_gaps is not None
    read = sorted(call["path"] for call in reads)
    assert read == sorted(file.path for file in find_scans(world.data))


ROOF = np.array([[-1.8, -0.7, -0.9], [0.6, 0.7, -0.4]])
NEIGHBOUR = np.array([[-1.0, 1.8, -1.3], [1.0, 2.4, 0.3]])
HEIGHT = 1.8


def rays(azimuths_deg=tuple(range(360)), elevations_deg=tuple(range(-40, 8))) -> np.ndarray:
    azimuth, elevation = np.meshgrid(np.radians(azimuths_deg), np.radians(elevations_deg))
    flat = np.cos(elevation)
    xyz = (flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation))
    return np.stack(xyz, axis=-1).reshape(-1, 3)


def hits(box: np.ndarray) -> np.ndarray:
    """Return the ranges at which rays meet a box, infinite for a miss."""
    with np.errstate(divide="ignore", invalid="ignore"):
        planes = box[:, None] / rays()
    entry, end = planes.min(axis=0).max(axis=1), planes.max(axis=0).min(axis=1)
    return np.where((entry < end) & (entry > 0), entry, np.inf)


def driven(count, *, moving=True, beside=0, roof=True, height=HEIGHT):
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
def test_scans_that_show_no_box(scans):
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
def test_the_vehicle_of_real_drives_is_in_the_box(real_data, drive):
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
