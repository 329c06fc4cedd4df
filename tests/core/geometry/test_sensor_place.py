# SPDX-License-Identifier: MIT
"""Sensors anywhere in the frame of their scans."""

import math
from dataclasses import replace

import numpy as np
import pytest
from calls import calls_of
from scans import SMALL
from street_scans import moved, street

from salsanext_cli import Scan, read_scan
from salsanext_cli.core.geometry.evenness import is_out_of_place
from salsanext_cli.core.geometry.ground import find_ground
from salsanext_cli.core.geometry.sensor_frame import in_sensor_frame
from salsanext_cli.core.geometry.sensor_of_scan import sensor_of
from salsanext_cli.core.geometry.sensor_place import find_place
from salsanext_cli.runs.scans.scan_search import find_scans

SIDES = {"z up": np.eye(3), "z down": np.diag([1.0, -1, -1])}
PLACES = [(2, -4, 0.5), (-16, 12, 3), (300, 400, 1)]


def turned(scan: Scan, rotation: np.ndarray) -> Scan:
    return Scan((scan.points @ rotation.T).astype(np.float32), scan.intensity)


def yaw(degrees: float) -> np.ndarray:
    cos, sin = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize(("side", "beams"), [("z up", 0), ("z down", 32)])
def test_the_sensor_of_a_street_in_any_frame(place, side, beams):
    scan = moved(turned(street(beams), yaw(50) @ SIDES[side]), place)
    found = find_place(scan)
    assert found.up.tolist() == SIDES[side][2].tolist()
    assert np.hypot(*(found.position - place)[:2]) < 0.8
    assert found.position[2] == pytest.approx(place[2], abs=0.25)


@pytest.mark.parametrize("metres", [5, 20, 100, 500])
def test_points_that_are_seen_from_elsewhere(metres):
    for angle, beams in ((0, 32), (2, 0), (4, 0)):
        place = (metres * math.cos(angle), metres * math.sin(angle), 0)
        assert is_out_of_place(moved(street(beams), place))


@pytest.mark.parametrize("beams", [0, 16, 64])
def test_points_that_are_seen_from_the_origin(beams):
    for seed in range(5):
        assert not is_out_of_place(street(beams, seed=seed))
    assert not find_place(street(beams)).is_elsewhere


def test_a_narrow_field_of_view_is_not_taken_for_another_place():
    scan = street(0)
    ahead = scan.take(np.flatnonzero(np.abs(np.arctan2(*scan.points.T[1::-1])) < 0.4))
    assert not is_out_of_place(ahead)
    assert find_place(ahead) is None


@pytest.mark.parametrize(
    "points",
    [
        np.zeros((0, 3)),
        np.zeros((3000, 3)),
        np.full((3000, 3), np.nan),
        np.full((3000, 3), 5.0),
        np.random.default_rng(0).normal(size=(3000, 3)) * 30,
        np.random.default_rng(0).normal(size=(500, 3)) * 30,
    ],
    ids=["none", "at the origin", "not a number", "alike", "a ball", "few"],
)
def test_points_that_show_no_sensor(points):
    scan = Scan(points.astype(np.float32), np.zeros(len(points), np.float32))
    assert find_place(scan) is None


@pytest.mark.parametrize("up", [(0.0, 0.0, 1.0), (0.0, 0.0, -1.0)])
def test_a_registered_scan_has_its_own_origin(up):
    sensor = replace(SMALL, up=up, registered=True)
    side = SIDES["z up" if up[2] > 0 else "z down"]
    scan = moved(turned(street(0), side), PLACES[1])
    placed = sensor_of(scan, sensor)
    seen = in_sensor_frame(scan, placed).points
    assert np.abs(seen - street(0).points).max() < 0.8
    assert sensor_of(scan, placed) == placed


@pytest.mark.real
@pytest.mark.parametrize("name", ["world_20m", "world_30m", "body_ned", "veh_ned", "nclt"])
def test_reported_frames(real_data, name):
    places = {
        "world_20m": (16, 12, 0),
        "world_30m": (24, 18, 3),
        "body_ned": (0, 0, -1.2),
        "veh_ned": (1.2, 0, -1.85),
        "nclt": (0, 0, -0.957),
    }
    (file,) = find_scans(real_data / "data/reported/round5/frames" / name)
    found = find_place(read_scan(file.path))
    assert found.is_elsewhere
    # The true origin is an estimate as well.
    assert np.hypot(*(found.position - places[name])[:2]) < 1.5
    assert found.position[2] == pytest.approx(places[name][2], abs=0.3)
    assert found.up[2] * (1 if name.startswith("world") else -1) > 0.99


def test_huge_coordinates_are_no_measurements():
    scan = moved(street(0), PLACES[1])
    points = scan.points.copy()
    points[::7] = [3e38, -1e30, 1e9]
    damaged = find_place(Scan(points, scan.intensity))
    assert np.hypot(*(damaged.position - PLACES[1])[:2]) < 0.8
    is_out_of_place(Scan(points, scan.intensity))


def test_the_place_of_a_scan_is_searched_once():
    """Further readings of the file give equal points."""
    scan = moved(street(0, seed=41), (12, 5, 1))
    with calls_of(find_ground) as searching:
        first = find_place(scan)
    with calls_of(find_ground) as remembering:
        again = find_place(Scan(scan.points.copy(), scan.intensity))
        unverified = find_place(scan, verified=False)
    assert again.position.tolist() == first.position.tolist()
    assert unverified.position.tolist() == first.position.tolist()
    other = scan.points + np.float32([0.01, 0, 0])
    with calls_of(find_ground) as searching_again:
        find_place(Scan(other, scan.intensity))
    assert searching
    assert not remembering
    assert searching_again
