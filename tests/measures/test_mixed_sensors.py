# SPDX-License-Identifier: MIT
"""Scans of two sensors in one run are noticed; different places of one sensor are not."""

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from scans import SMALL

from salsanext_cli import Scan, read_scan, sensor
from salsanext_cli.fitting.scan_checks import ScanCheck, ScanTraits, check_scan
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
    remedies = {finding.remedy for finding in found.values()}
    apart = ("00", "08") if fewer == "00" else ("08", "00")
    (remedy,) = {remedy.partition(" such as")[0] for remedy in remedies}
    assert remedy == f"give {apart[0]} and {apart[1]} as SCANS of their own,"


def test_intensities_of_two_scales_are_told_apart():
    usual, bytes_ = (replace(OF["of-64"][0], bright=bright) for bright in (0.5, 130.0))
    none = replace(usual, bright=0.0)
    scans = dict(zip(files("08", 4), [usual, usual, bytes_, none], strict=True))
    (file,) = found = mixed_sensors(scans)
    assert file.stem == "000002"
    assert found[file].remedy.startswith("put the scans of each sensor into a folder of their own")
    assert "intensities to 1.3e+02" in found[file].found


def test_a_run_says_it_at_its_end(caplog):
    summary = RunSummary(SMALL)
    for file, of_scan in zip(files("08", 5), [*OF["of-64"][:4], OF["of-16"][0]], strict=True):
        summary.add(ScanSummary(file, ScanCheck((), of_scan)))
    assert not caplog.messages
    (warning,) = summary.finished().warnings()
    assert (warning["code"], warning["scans"]) == ("mixed-sensors", ["08/000004"])
    assert "such as 08/000000" in caplog.text


def real_sensors(folder: Path) -> dict[str, list[ScanTraits]]:
    """Return the traits of scans by sensor; two HDL-64 and two HDL-32 are one each."""
    usual = sensor("hdl64-512")
    five = replace(usual, columns=("x", "y", "z", "intensity", "ring"))
    single = (
        "ouster/os0_128.bin",
        "ouster/os1_128.bin",
        "ouster/os2_32.bin",
        "pcd/livox_front.pcd",
    )
    single += ("pcd/os1_ascii_half_zeros.pcd", "pcd/ring40_padding_fields.pcd")
    names = {
        "hdl64": (usual, "semantickitti/sequences/*/velodyne/*.bin"),
        "pandar64": (usual, "pandaset/sequences/*/velodyne/*.bin"),
        "hdl32": (usual, "sensors/nuscenes_hdl32/**/*.bin"),
        "hdl64s3": (five, "sensors/five_columns_hdl64s3.bin"),
        "beams128": (usual, "sensors/pcd/beams128_binary_compressed.pcd"),
    } | {name: (usual, f"sensors/{name}") for name in single}
    return {
        name: [traits(read_scan(path, of), of) for path in sorted(folder.glob(pattern))]
        for name, (of, pattern) in names.items()
    }


@pytest.mark.real
def test_real_sensors_are_told_apart_and_no_place(real_data):
    sensors = real_sensors(real_data / "data")
    assert len(sensors["pandar64"]) == 42
    for of_one in sensors.values():
        for some in (of_one, *combinations(of_one, 2)):
            assert mixed_sensors(dict(zip(files("08", len(some)), some, strict=True))) == {}
    for one, other in combinations(sensors.values(), 2):
        for counts in ((5, 5), (9, 1), (1, 9)):
            parts = zip(("00", "08"), counts, (one, other), strict=True)
            scans = {
                file: of_sensor[number % len(of_sensor)]
                for sequence, count, of_sensor in parts
                for number, file in enumerate(files(sequence, count))
            }
            found = mixed_sensors(scans)
            assert len({file.sequence for file in found}) == 1
            assert len(found) == min(counts)
