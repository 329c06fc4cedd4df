# SPDX-License-Identifier: MIT
"""Scans of two sensors in one run are noticed; different places of one sensor are not."""

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from scans import SMALL

from salsanext_cli import Scan
from salsanext_cli.fitting.scan_checks import ScanCheck, check_scan
from salsanext_cli.measures.scan_summary import RunSummary, ScanSummary, mixed_sensors
from salsanext_cli.results.layout import ScanFile

FILE = Path("scan.bin")
BEAMS = {
    "of-16": (np.linspace(15, -15, 16), 450),
    "of-32": (np.linspace(10.67, -30.67, 32), 272),
    "of-64": (np.linspace(2, -24.9, 64), 512),
    "dense": (np.concatenate([np.linspace(15, -6, 52), np.linspace(-7, -25, 12)]), 450),
    "wide": (np.linspace(45, -45, 128), 256),
    "half-wide": (np.linspace(22.5, -22.5, 128), 256),
}
"""Elevations of beams in degrees, and a quarter of the columns, as rotating sensors have them."""


def scan_of(name, place, brightest=0.5):
    """Return a scan at one of many places: open or narrow, with sky above, on a car or a robot."""
    beams, columns = BEAMS[name]
    random = np.random.default_rng((place, len(beams)))
    elevation, azimuth = np.meshgrid(np.radians(beams), np.linspace(-np.pi, np.pi, columns))
    elevation = elevation + np.radians(random.normal(0, 0.02, elevation.shape))
    walls = random.uniform(6, 60) * (1.5 + np.sin(random.integers(1, 4) * azimuth))
    wall, tall = walls / np.cos(elevation), walls * np.tan(elevation) < random.uniform(1, 15)
    height = random.uniform(1.5, 2.1)
    ground = -height / np.minimum(np.sin(elevation), -1e-3)
    distance = np.where(tall, np.minimum(wall, ground), ground)
    kept = (distance < 100) & (random.random(distance.shape) < random.uniform(0.9, 1))
    flat = distance * np.cos(elevation)
    xyz = (flat * np.cos(azimuth), flat * np.sin(azimuth), distance * np.sin(elevation))
    points = np.stack(xyz, axis=-1)[kept].astype(np.float32)
    bright = np.linspace(0, brightest * random.uniform(0.7, 1.4), len(points))
    return Scan(points, bright.astype(np.float32))


def traits(scan, of=SMALL):
    return check_scan(FILE, scan, of).traits


def files(sequence, count):
    return [ScanFile(sequence, f"{number:06d}", FILE) for number in range(count)]


OF = {name: [traits(scan_of(name, place)) for place in range(9)] for name in BEAMS}


@pytest.mark.parametrize("name", BEAMS)
def test_places_of_one_sensor_are_not_told_apart(name):
    assert mixed_sensors(dict(zip(files("08", 9), OF[name], strict=True))) == {}
    for pair in combinations(OF[name], 2):
        assert mixed_sensors(dict(zip(files("08", 2), pair, strict=True))) == {}


@pytest.mark.parametrize(("one", "other"), [*combinations(BEAMS, 2)])
@pytest.mark.parametrize(("of_one", "of_other"), [(6, 6), (9, 1), (1, 9)])
def test_two_sensors_are_told_apart(one, other, of_one, of_other):
    scans = dict(zip(files("00", of_one), OF[one], strict=False))
    scans |= dict(zip(files("08", of_other), OF[other], strict=False))
    found = mixed_sensors(scans)
    fewer = "00" if of_one < of_other else "08"
    assert {file for file in scans if file.sequence == fewer} == found.keys()
    assert {finding.code for finding in found.values()} == {"mixed-sensors"}


def test_intensities_of_two_scales_are_told_apart():
    usual, bytes_ = (replace(OF["of-64"][0], bright=bright) for bright in (0.5, 130.0))
    none = replace(usual, bright=0.0)
    scans = dict(zip(files("08", 4), [usual, usual, bytes_, none], strict=True))
    (file,) = found = mixed_sensors(scans)
    assert file.stem == "000002"
    assert "intensities to 1.3e+02" in found[file].found


def test_a_run_says_it_at_its_end(caplog):
    summary = RunSummary(SMALL)
    for file, of_scan in zip(files("08", 5), [*OF["of-64"][:4], OF["of-16"][0]], strict=True):
        summary.add(ScanSummary(file, ScanCheck((), of_scan)))
    assert not caplog.messages
    (warning,) = summary.finished().warnings()
    assert (warning["code"], warning["scans"]) == ("mixed-sensors", ["08/000004"])
    assert "such as 08/000000" in caplog.text
