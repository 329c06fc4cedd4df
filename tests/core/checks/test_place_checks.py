# SPDX-License-Identifier: MIT
"""Positions of a sensor that a fit must not accept, or not reject, too soon."""

from pathlib import Path

import numpy as np
import pytest
from scans import SMALL
from street_scans import HEIGHT, moved, street

from salsanext_cli import Scan, read_scan
from salsanext_cli.core.checks.scan_checks import check_scan
from salsanext_cli.core.fitting import upright_scans
from salsanext_cli.core.fitting.field_of_view import fit_view
from salsanext_cli.core.fitting.mounting_fit import fit_mounting
from salsanext_cli.core.geometry.beam_origin import PROVING_SHARPNESS, sharpness_at_origin
from salsanext_cli.core.geometry.evenness import is_out_of_place
from salsanext_cli.core.geometry.ground import ground_of
from salsanext_cli.core.geometry.sensor_of_scan import sensor_of


def square(seed: int = 0) -> Scan:
    """Return a scan of a wide square with low houses, most of whose beams are near the horizon."""
    count = 40_000
    random = np.random.default_rng(seed)
    teeth = np.linspace(-30.67, 10.67, 32)
    weights = np.where(np.abs(teeth + 0.5) < 2.2, 14.0, 1.0)
    elevation = np.radians(random.choice(teeth, count, p=weights / weights.sum()))
    azimuth = random.uniform(-np.pi, np.pi, count)
    with np.errstate(divide="ignore"):
        ground = np.where(elevation < 0, -HEIGHT / np.tan(elevation), np.inf)
    houses = np.where(np.floor(azimuth * 9) % 2 == 0, 45, 55)
    posts = np.where(azimuth * 20 % 1 < 0.06, 14, np.inf)
    flat = np.minimum(np.minimum(ground, houses), posts) + random.normal(0, 0.01, count)
    rays = np.stack([np.cos(azimuth), np.sin(azimuth), np.tan(elevation)], axis=1)
    points = (rays * flat[:, None])[flat * np.tan(elevation) < 3].astype(np.float32)
    return Scan(points, random.random(len(points), np.float32))


def codes(scan: Scan) -> set[str]:
    """Return the codes of a scan with the sensor that is fitted to it."""
    sensor = sensor_of(scan, fit_view([scan], SMALL))
    return {finding.code for finding in check_scan(Path("s.bin"), scan, sensor, SMALL).findings}


def test_far_objects_make_a_wrong_origin_sharp_which_is_not_accepted():
    place = (2.2, 1.6, -1.2)
    scan = moved(square(), place)
    above_ground = scan.points[scan.points[:, 2] > -HEIGHT + place[2] + 0.4]
    assert sharpness_at_origin(above_ground) > PROVING_SHARPNESS
    assert fit_mounting([scan], SMALL).origin == pytest.approx(place, abs=0.05)


def test_a_sharp_origin_that_is_right_stays():
    raised = Scan(square().points * np.float32(1.7), square().intensity)
    assert not ground_of(raised).is_usual
    assert fit_mounting([raised], SMALL) == SMALL


@pytest.mark.parametrize("place", [(0, 0, 3), (10, 5, 3.3)])
def test_an_origin_below_the_ground_is_not_upside_down(place):
    scan = moved(street(0), place)
    ground = ground_of(scan)
    assert ground.up[2] > 0.99
    assert ground.height == pytest.approx(HEIGHT - place[2], abs=0.1)
    sensor = fit_mounting([scan], SMALL)
    assert sensor.up == (0.0, 0.0, 1.0)
    assert sensor.origin == pytest.approx(place, abs=0.3)


def test_a_hanging_sensor_is_upside_down():
    hanging = Scan(street(0).points * np.float32([1, -1, -1]), street(0).intensity)
    assert ground_of(hanging).up[2] < -0.99
    assert fit_mounting([hanging], SMALL).up[2] < -0.99


def fan(beams: int) -> Scan:
    """Return the part of a street ahead, as a solid-state sensor sees it."""
    scan = street(beams)
    return scan.take(np.flatnonzero(np.abs(np.arctan2(*scan.points.T[1::-1])) < 0.8))


@pytest.mark.parametrize("place", [(0, 0, HEIGHT), (3, 2, HEIGHT)])
def test_a_position_that_nothing_proves_is_doubted(place):
    """A fan is as even from positions beside that of its sensor."""
    scan = moved(fan(0), place)
    assert fit_mounting([scan], SMALL).origin != SMALL.origin
    assert "out-of-place" in codes(scan)


def test_fans_at_the_origin_and_circles_are_not_doubted():
    assert "out-of-place" not in codes(fan(0))
    assert "out-of-place" not in codes(moved(street(0), (0, 0, HEIGHT)))


def test_scans_without_doubt_are_not_at_the_origin(monkeypatch):
    """Their sensor is where the others are, too."""
    scans = [moved(street(0, seed=seed), (16, 12, 0)) for seed in range(3)]
    calm = scans[2].points

    def is_uneven(scan: Scan) -> bool:
        return not np.array_equal(scan.points, calm) and is_out_of_place(scan)

    monkeypatch.setattr(upright_scans, "is_out_of_place", is_uneven)
    sensor = fit_mounting(scans, SMALL)
    assert not sensor.registered
    assert sensor.origin == pytest.approx((16, 12, 0), abs=0.6)


@pytest.mark.real
@pytest.mark.parametrize("name", ["five_columns.pcd.bin", "four_columns/velodyne/000001.bin"])
def test_reported_sharp_origins(real_data, name):
    scan = read_scan(real_data / "data/sensors/nuscenes_hdl32" / name)
    place = (5, 0, -0.9)
    assert fit_mounting([moved(scan, place)], SMALL).origin == pytest.approx(place, abs=0.4)
