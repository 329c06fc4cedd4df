# SPDX-License-Identifier: MIT
from dataclasses import replace

import numpy as np
import pytest
from scans import SMALL, make_scan

from salsanext_cli import Scan, project, read_scan
from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.fitting import scan_fit
from salsanext_cli.fitting.scan_checks import share_outside
from salsanext_cli.fitting.view_fit import SHOWN, fit_view
from salsanext_cli.geometry.projection import upright_rotation
from salsanext_cli.results.layout import find_scans

SCANS = [make_scan(3000, seed) for seed in range(3)]

TOLD = replace(SMALL, min_range=0.0, ego_box=())
"""What else is found is told."""


def outside(scan, sensor):
    """Return the share of the points of a scan outside of a view."""
    return share_outside(scan.points[:, 2] / np.linalg.norm(scan.points, axis=1), sensor)


def turned(scan, up):
    points = scan.points @ upright_rotation(np.asarray(up, float))
    return Scan(points.astype(np.float32), scan.intensity)


def test_a_view_that_fits_is_left_alone():
    assert fit_view(SCANS, TOLD) == TOLD
    nearly = replace(TOLD, fov_up=1.0)
    assert fit_view(SCANS, nearly) == nearly


def test_another_view_is_found_and_the_image_stays():
    above = replace(TOLD, fov_up=25.0, fov_down=-7.0)
    found = fit_view(SCANS, above)
    assert (found.fov_up, found.fov_down) == pytest.approx((3, -25), abs=0.3)
    shares = [outside(scan, found) for scan in SCANS]
    assert max(shares) < 0.01
    assert replace(found, name="small", fov_up=25.0, fov_down=-7.0) == above


@pytest.mark.parametrize("out_of_view", ["clamp", "drop"])
def test_points_above_and_below_the_view_are_counted_one_by_one(out_of_view):
    elevations = np.array([-90, -60, -25.1, -24.9, 0, 2.9, 3.1, 89])
    sensor = replace(SMALL, out_of_view=out_of_view)
    assert share_outside(np.sin(np.radians(elevations)), sensor) == 5 / 8
    assert share_outside(np.empty(0), sensor) == 0


@pytest.mark.parametrize("extent", [5.0, 15.0, 22.0])
def test_no_more_is_shown_than_most_points_need(extent):
    """Else objects would be lower in the image than those of training."""
    found = fit_view(SCANS, replace(SMALL, fov_up=30.0 + extent, fov_down=30.0))
    elevations = [
        np.degrees(np.arcsin(s.points[:, 2] / np.linalg.norm(s.points, axis=1))) for s in SCANS
    ]
    elevations = np.sort(np.concatenate(elevations))
    count = round(SHOWN * len(elevations))
    narrowest = min(b - a for a, b in zip(elevations, elevations[count - 1 :], strict=False))
    assert found.fov_up - found.fov_down == pytest.approx(max(narrowest, extent), abs=0.1)
    shares = [outside(scan, found) for scan in SCANS]
    assert np.mean(shares) < 1 - SHOWN + 0.01


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
    elevations, azimuths = np.radians(np.linspace(-45, 45, 128)), np.radians(np.arange(0, 360, 0.5))
    azimuth, elevation = (each.ravel() for each in np.meshgrid(azimuths, elevations))
    flat = np.cos(elevation)
    rays = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=1)
    walls = np.array([[-3.2, -2.3, -height], [4.8, 2.7, 2.6 - height]])
    with np.errstate(divide="ignore"):
        ranges = (walls[:, None] / rays).max(axis=0).min(axis=1)
    ranges = ranges + np.random.default_rng(0).normal(0, 0.01, len(ranges))
    points = (rays * ranges[:, None]).astype(np.float32)
    found = fit_view([Scan(points, np.zeros(len(points), np.float32))], SMALL)
    assert (found.up, found.origin) == (SMALL.up, SMALL.origin)
    assert -46 < found.fov_down < found.fov_up < 46


def test_each_scan_is_read_once_for_view_intensity_and_gaps(world, monkeypatch):
    read = []

    def counted(path, *arguments):
        read.append(path)
        return read_scan(path, *arguments)

    monkeypatch.setattr(scan_fit, "read_scan", counted)
    settings = NetworkSettings(device="cpu", engine="torch")
    network = settings.load()
    sample = scan_fit.ScanSample(find_scans(world.data), network.sensor)
    network = scan_fit.fit_scans(settings, network, sample)
    assert len(sample.images(network.sensor)) == len(read)
    assert network.sensor.intensity_quantiles
    assert network.sensor.row_gaps is not None
    assert sorted(read) == sorted(file.path for file in find_scans(world.data))
