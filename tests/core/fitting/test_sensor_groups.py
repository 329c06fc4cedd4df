# SPDX-License-Identifier: MIT
"""Folders with the scans of several sensors, of which some are registered to a map."""

import numpy as np
import pytest
from scans import SMALL
from street_scans import HEIGHT, low_street, moved, street, street_points

from salsanext_cli import Scan
from salsanext_cli.core.fitting.scan_sample import ScanSample
from salsanext_cli.core.fitting.sensor_groups import sensor_groups
from salsanext_cli.core.fitting.view_fit import fit_sensor
from salsanext_cli.core.geometry.sensor_of_scan import member_of, sensor_of

WAY = [(0, 0, 0), (7, 0, 0), (14, 0, 0)]


def folder() -> list[Scan]:
    """Return scans of a drive in the frame of its first scan, and of another sensor in between."""
    drive = [moved(street(32, seed=seed), place) for seed, place in enumerate(WAY)]
    others = [low_street(seed) for seed in range(2)]
    return [drive[0], others[0], drive[1], others[1], drive[2]]


DRIVE = (0, 2, 4)
OTHERS = (1, 3)


def test_registered_scans_are_one_group_beside_another():
    groups = sensor_groups(folder(), SMALL)
    assert [group.numbers for group in groups] == [DRIVE, OTHERS]


def leaning(scan: Scan, degrees: float) -> Scan:
    """Return a level scan as a sensor that leans forwards measures it in a level frame."""
    angle = np.radians(degrees)
    ranges = np.linalg.norm(scan.points, axis=1)
    elevation = np.arcsin(scan.points[:, 2] / ranges)
    azimuth = np.arctan2(scan.points[:, 1], scan.points[:, 0])
    elevation -= angle * np.cos(azimuth)
    noise = np.zeros(len(ranges))
    return Scan(street_points(azimuth, elevation, HEIGHT, 60, noise), scan.intensity)


def test_a_registered_drive_over_bumps_is_one_group():
    places = [(5 * step + 20, 10, 0) for step in range(5)]
    leans = [0, 8, 0, 0, 8]
    drive = [
        moved(leaning(street(32, seed=seed), lean), place)
        for seed, (lean, place) in enumerate(zip(leans, places, strict=True))
    ]
    assert [group.numbers for group in sensor_groups(drive, SMALL)] == [(0, 1, 2, 3, 4)]


def test_a_registered_scan_with_few_points_is_no_fixed_sensor():
    drive = [moved(street(32, seed=seed), (7 * seed + 20, 10, 0)) for seed in range(3)]
    thinned = drive[1].take(np.arange(0, len(drive[1]), 5))
    groups = sensor_groups([drive[0], thinned, drive[2]], SMALL)
    assert [group.numbers for group in groups] == [(0, 1, 2)]


@pytest.fixture(scope="module")
def fitted():
    return fit_sensor(ScanSample.from_scans(folder()), SMALL)


def test_each_group_has_its_fit(fitted):
    assert [member.registered for member in fitted.members] == [True, False]
    alone = [
        fit_sensor(ScanSample.from_scans([folder()[n] for n in numbers]), SMALL)
        for numbers in (DRIVE, OTHERS)
    ]
    for member, sensor in zip(fitted.members, alone, strict=True):
        assert member.traits
        assert (member.up, member.origin, member.fov_up, member.fov_down) == (
            sensor.up,
            sensor.origin,
            sensor.fov_up,
            sensor.fov_down,
        )


def test_scans_are_of_their_sensor_and_registered_ones_have_their_origin(fitted):
    scans = folder()
    assert [member_of(scan, fitted) for scan in scans] == [0, 1, 0, 1, 0]
    for number, place in zip(DRIVE, WAY, strict=True):
        assert np.abs(np.array(sensor_of(scans[number], fitted).origin) - place).max() < 0.6
    for number in OTHERS:
        assert sensor_of(scans[number], fitted) == fitted.others[0]


def test_an_earlier_fit_stays(fitted):
    assert fit_sensor(ScanSample.from_scans(folder()[1:]), SMALL, fitted) == fitted


def test_a_later_scan_of_the_drive_has_its_origin_too(fitted):
    later = moved(street(32, seed=9), (60, 5, 1))
    assert sensor_of(later, fitted).origin == pytest.approx((60, 5, 1), abs=0.6)


def test_an_origin_that_is_known_is_not_searched(fitted):
    scans = folder()
    placed = sensor_of(scans[2], fitted, (7.0, 0.0, 0.0))
    assert placed.origin == (7.0, 0.0, 0.0)
    assert sensor_of(scans[1], fitted, (0.0, 0.0, 0.0)) == fitted.others[0]
