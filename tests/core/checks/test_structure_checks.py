# SPDX-License-Identifier: MIT
import math
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from scans import SMALL, make_scan

from salsanext_cli import Scan
from salsanext_cli.core.checks.scan_checks import check_scan
from salsanext_cli.core.checks.scan_structure import structure_of
from salsanext_cli.core.checks.structure_checks import MAX_HIDDEN, MAX_IN_AIR
from salsanext_cli.core.errors import FormatError
from salsanext_cli.core.fitting.field_of_view import fit_view
from salsanext_cli.core.geometry.directions import COLUMNS, NEAREST_M, NO_CELL, ROWS, direction_grid
from salsanext_cli.core.geometry.intensity import NO_INTENSITY
from salsanext_cli.core.measures.expected_accuracy import WITHHELD_FOR, expected_accuracy
from salsanext_cli.core.network.card import AccuracyLine
from salsanext_cli.core.records import FieldSplit, FileNotes
from salsanext_cli.io.formats import read_scan
from salsanext_cli.io.sensors import sensor
from salsanext_cli.io.weights.card_file import default_weights, read_card

HEIGHT_M, FARTHEST_M = 1.7, 60.0
PILLARS = np.random.default_rng(1).uniform((-30, -30, 1), (60, 30, 3), (60, 3))
"""Position and radius of pillars, of which those around the way of the sensor are left out."""
PILLARS = PILLARS[np.abs(PILLARS[:, 1]) > 6]
BEAMS_DEG = np.linspace(3, -25, 64)
CODES = {"accumulated", "noisy", "near-returns", "depth-image"}


def seen_from(ahead, directions):
    """Return the points, in the frame of a sensor that moved ahead, of rays in a scene."""
    x, y, z = directions.T
    flat = np.hypot(x, y)
    ranges = np.full(len(x), FARTHEST_M)
    below = z < -1e-3
    ranges[below] = np.minimum(ranges[below], -HEIGHT_M / z[below])
    for px, py, radius in PILLARS:
        along = ((px - ahead) * x + py * y) / flat
        across = ((px - ahead) ** 2 + py**2) - along**2
        reach = (along - np.sqrt(np.maximum(radius**2 - across, 0))) / flat
        hit = (across < radius**2) & (along > 0)
        ranges = np.where(hit, np.minimum(ranges, reach), ranges)
    return directions * ranges[:, None]


def turned(beams_deg=BEAMS_DEG, columns=1024):
    """Return the directions of a rotating sensor."""
    elevation, azimuth = np.meshgrid(np.radians(beams_deg), np.linspace(-np.pi, np.pi, columns))
    flat = np.cos(elevation)
    rays = (flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation))
    return np.stack(rays, axis=-1).reshape(-1, 3)


def scan_of(points, *, intensity=True):
    values = np.random.default_rng(0).random(len(points)) * intensity
    return Scan(points.astype(np.float32), values.astype(np.float32))


@cache
def seen_while_turning(ahead):
    """Return the points, in the frame of a rotating sensor that moved ahead."""
    return seen_from(ahead, turned())


@cache
def sweeps(count):
    """Return successive scans, 2 m apart, in the frame of the last one; nobody changes them."""
    clouds = [seen_while_turning(-2.0 * k) - (2.0 * k, 0, 0) for k in range(count)]
    return scan_of(np.concatenate(clouds))


def foggy(share):
    points, rng = seen_while_turning(0.0).copy(), np.random.default_rng(0)
    echo = rng.random(len(points)) < share
    ranges = np.linalg.norm(points, axis=1)
    points[echo] *= (rng.uniform(2.5, 12, echo.sum()) / ranges[echo])[:, None].clip(max=1)
    return scan_of(points)


def shaken(deviation):
    points = seen_while_turning(0.0)
    return scan_of(points + np.random.default_rng(0).normal(0, deviation, points.shape))


def depth_image(focal=300, tilt_deg=0.0, *, intensity=False):
    """Return the points of a pinhole grid of 640 × 480 pixels in steps of two."""
    v, u = np.mgrid[0:480:2, 0:640:2]
    rays = np.stack([np.full(u.shape, focal), 320 - u, 240 - v], axis=-1).reshape(-1, 3)
    rays = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    cosine, sine = math.cos(math.radians(tilt_deg)), math.sin(math.radians(tilt_deg))
    rays = rays @ np.array([[cosine, 0, -sine], [0, 1, 0], [sine, 0, cosine]])
    points = seen_from(0, rays)
    return scan_of(points[np.linalg.norm(points, axis=1) < 40], intensity=intensity)


def codes(scan, mounted=SMALL):
    return {finding.code for finding in check_scan(Path("s.bin"), scan, mounted).findings} & CODES


@pytest.mark.parametrize(
    ("make", "expected"),
    [
        (partial(sweeps, 1), set()),
        (partial(sweeps, 10), {"accumulated"}),
        (partial(sweeps, 5), {"accumulated"}),
        (partial(foggy, 0.003), set()),
        (partial(foggy, 0.03), {"near-returns"}),
        (partial(shaken, 0.01), set()),
        (partial(shaken, 0.2), {"noisy"}),
        (depth_image, {"depth-image"}),
        (partial(depth_image, tilt_deg=5), {"depth-image"}),
        (partial(depth_image, intensity=True), set()),
        (lambda: scan_of(seen_while_turning(0.0), intensity=False), set()),
    ],
)
def test_structures_that_no_lidar_sees_are_findings(make, expected):
    assert codes(make()) == expected


def returns_of(first, order):
    """Return the first returns of pulses with second ones, of a third of them, in an order."""
    has_second = np.random.default_rng(0).random(len(first)) < 0.3
    factor = 1.4 + 2 / np.linalg.norm(first, axis=1)
    second = first * np.where(has_second, factor, 1)[:, None]
    if order == "in turn":
        return np.stack([first, second], axis=1).reshape(-1, 3)
    if order == "last one first":
        return np.stack([second, first], axis=1).reshape(-1, 3)
    if order == "without empty ones":
        pairs = np.stack([first, second], axis=1).reshape(-1, 3)
        return pairs[np.stack([np.ones_like(has_second), has_second], axis=1).ravel()]
    if order == "by firing":
        firings = [part.reshape(-1, len(BEAMS_DEG), 3) for part in (first, second)]
        return np.stack(firings, axis=1).reshape(-1, 3)
    return np.concatenate([first, np.where(has_second[:, None], second, 0)])


RETURN_ORDERS = ("in turn", "last one first", "without empty ones", "by firing", "in halves")


@pytest.mark.parametrize("order", RETURN_ORDERS)
def test_second_returns_of_the_same_pulses_are_not_several_scans(order):
    first = seen_while_turning(0.0)
    assert codes(scan_of(returns_of(first, order))) == set()
    # Laser and receiver are not exactly at the origin of the frame.
    moved = returns_of(first + (0.02, 0, 0.05), order) - (0.02, 0, 0.05)
    assert codes(scan_of(moved + (0, 0.03, 0.1))) == set()
    clouds = [returns_of(seen_while_turning(-2.0 * k), order) - (2.0 * k, 0, 0) for k in range(5)]
    assert codes(scan_of(np.concatenate(clouds))) == {"accumulated"}


def test_returns_in_no_order_are_named_by_the_hint():
    points = returns_of(seen_while_turning(0.0), "in turn")
    scan = scan_of(np.random.default_rng(1).permutation(points))
    (found,) = (f for f in check_scan(Path("s.bin"), scan, SMALL).findings if f.code in CODES)
    assert found.code == "accumulated"
    assert "pulse" in found.hint


def test_vehicles_that_carried_the_sensor_do_not_look_like_fog():
    rng = np.random.default_rng(0)
    vehicles = [
        rng.uniform((-3, -3, -1.5), (3, 3, -0.3), (200, 3)) - (2.0 * k, 0, 0) for k in range(10)
    ]
    ten = scan_of(np.concatenate([sweeps(10).points, *vehicles]))
    assert structure_of(ten, SMALL).in_air > MAX_IN_AIR
    assert codes(ten) == {"accumulated"}


def test_several_scans_are_found_from_the_origin_of_the_file_too():
    """A sensor was fitted between the positions, from where few points are hidden."""
    fitted = replace(SMALL, origin=(-9.0, 5.0, 4.0))
    assert structure_of(sweeps(10), fitted).hidden < MAX_HIDDEN
    assert codes(sweeps(10), fitted) == {"accumulated"}


def test_several_scans_are_found_if_a_place_between_them_was_fitted():
    four = sweeps(4)
    fitted = fit_view([four], SMALL)
    assert fitted.origin != SMALL.origin
    assert structure_of(four, fitted).hidden < MAX_HIDDEN < structure_of(four, SMALL).hidden
    assert codes(four, fitted) == {"accumulated"}


@pytest.mark.parametrize("place", [(4, 1, 0), (8, -4, 0), (-8, 3, 0)])
def test_a_moved_scan_is_no_several_scans(place):
    one = sweeps(1)
    moved = Scan(one.points + np.float32(place), one.intensity)
    fitted = fit_view([moved], SMALL)
    assert structure_of(moved, SMALL).hidden > MAX_HIDDEN
    assert codes(moved, fitted) == set()


@pytest.mark.parametrize("beams", [16, 32, 128])
def test_sensors_of_few_and_many_beams_have_no_finding(beams):
    points = seen_from(0, turned(np.linspace(15, -25, beams), 900))
    assert codes(scan_of(points)) == set()
    narrow = np.abs(points[:, 1]) < 0.3 * points[:, 0]
    assert codes(scan_of(points[narrow], intensity=False)) == set()


@pytest.mark.parametrize(
    ("split", "words"),
    [
        (None, ["fuse"]),
        (FieldSplit(field="lidar_id", kind="sensor", count=2), ["lidar_id", "2"]),
        (FieldSplit(field="sweep", kind="scan", count=10), ["sweep", "10", "fuse"]),
        (FieldSplit(field="timestamp", kind="time", count=4096), ["timestamp", "fuse"]),
    ],
)
def test_the_hint_names_the_field_that_divides_a_cloud(split, words):
    ten = replace(sweeps(10), notes=FileNotes(split=split))
    (found,) = (f for f in check_scan(Path("s.bin"), ten, SMALL).findings if f.code in CODES)
    assert found.code == "accumulated"
    assert all(word in found.hint for word in words)
    assert codes(replace(sweeps(1), notes=FileNotes(split=split))) == (
        {"accumulated"} if split and split.kind == "sensor" else set()
    )


def test_the_origin_and_direction_up_of_the_sensor_count():
    ten = sweeps(10)
    raised = Scan((ten.points + np.float32([3, 1, 2])) * np.float32([1, -1, -1]), ten.intensity)
    mounted = replace(SMALL, origin=(3.0, -1.0, -2.0), up=(0.0, 0.0, -1.0))
    expected, measured = structure_of(ten, SMALL), structure_of(raised, mounted)
    assert measured.hidden == pytest.approx(expected.hidden, abs=0.003)
    one = sweeps(1)
    elsewhere = structure_of(Scan(one.points + np.float32([6, 6, 0]), one.intensity), SMALL)
    assert elsewhere.hidden > structure_of(one, SMALL).hidden


def test_a_few_points_have_no_structure():
    assert structure_of(make_scan(60), SMALL) is None
    assert (
        structure_of(Scan(np.full((500, 3), np.nan, np.float32), np.zeros(500, "f4")), SMALL)
        is None
    )


@pytest.mark.parametrize("make", [partial(foggy, 0.02), partial(foggy, 0.2), partial(shaken, 0.2)])
def test_confident_weights_do_not_lead_to_an_estimate_in_fog_and_noise(make):
    warnings = {code: ["s"] for code in codes(make())}
    estimate = expected_accuracy(AccuracyLine(1.0, 0.0, 0.01), {"s": 0.99}, warnings)
    assert estimate.accuracy is None


def test_no_estimate_for_these():
    assert set(WITHHELD_FOR) >= CODES
    without = replace(SMALL, intensity_quantiles=NO_INTENSITY)
    assert codes(depth_image(), without) == {"depth-image"}


def test_grid_and_structure_agree_with_a_slow_loop():
    scan = sweeps(3)
    sector = np.flatnonzero(
        (scan.points[:, 0] > 0) & (np.abs(scan.points[:, 1]) > scan.points[:, 0])
    )
    scan = scan.take(np.random.default_rng(0).permutation(sector)[:8000])
    scan.points[::500] = np.nan
    scan.points[1::500] = 0
    cells, nearest = {}, {}
    for i, (x, y, z) in enumerate(scan.points.astype(float)):
        distance = math.sqrt(x * x + y * y + z * z)
        if not distance >= NEAREST_M:
            continue
        column = min(int((math.atan2(y, x) / math.pi + 1) / 2 * COLUMNS), COLUMNS - 1)
        row = min(int((z / distance + 1) / 2 * ROWS), ROWS - 1)
        cells[i] = row, column
        nearest[row, column] = min(nearest.get((row, column), math.inf), np.float32(distance))
    grid = direction_grid(scan, SMALL)
    flat = np.array(
        [cells[i][0] * COLUMNS + cells[i][1] if i in cells else NO_CELL for i in range(len(scan))]
    )
    assert (grid.cell_of_point == flat).mean() > 0.999
    ranges = np.linalg.norm(scan.points, axis=1)
    hidden = in_air = 0
    deviations = []
    for i, (row, column) in cells.items():
        own = nearest[row, column]

        def beside(down, right, row=row, column=column):
            return nearest.get((row + down, (column + right) % COLUMNS))

        square = [beside(v, u) for v in (-1, 0, 1) for u in (-1, 0, 1)]
        surface = [r for r in square if r is not None]
        gap = ranges[i] - max(surface)
        hidden += len(surface) >= 5 and gap > max(1, 0.05 * max(surface))
        others = [beside(v, u) for v in (-1, 0, 1) for u in (-2, -1, 0, 1, 2) if (v, u) != (0, 0)]
        others = [r for r in others if r is not None]
        in_front = len(others) >= 4 and min(others) - own > max(0.5, 0.05 * own)
        in_air += in_front and own < 15
        left, right = beside(0, -1), beside(0, 1)
        if left is not None and right is not None:
            deviations.append(abs(own - (left + right) / 2) / own)
    structure = structure_of(scan, SMALL)
    assert hidden > 20
    assert structure.hidden == pytest.approx(hidden / len(cells), abs=1e-3)
    assert structure.in_air == pytest.approx(in_air / len(cells), abs=1e-3)
    assert structure.roughness == pytest.approx(np.median(deviations), rel=0.02)


@pytest.mark.real
@pytest.mark.parametrize("start", [0, 10, 20])
@pytest.mark.parametrize("sequence", ["0001", "0004"])
def test_ten_scans_of_a_drive_in_one_are_a_finding_of_a_fitted_sensor(real_data, sequence, start):
    drive = real_data / "data/drives/sequences" / sequence
    poses = np.loadtxt(drive / "poses.txt").reshape(-1, 3, 4)[start : start + 10]
    scans = [read_scan(path) for path in sorted((drive / "velodyne").iterdir())[start : start + 10]]
    rotation, position = poses[0, :, :3], poses[0, :, 3]
    clouds = [
        (scan.points @ pose[:, :3].T + pose[:, 3] - position) @ rotation
        for scan, pose in zip(scans, poses, strict=True)
    ]
    cloud = scan_of(np.concatenate(clouds))
    fitted = fit_view([cloud], read_card(default_weights()).sensor)
    assert codes(cloud, fitted) == {"accumulated"}


@pytest.mark.real
def test_ten_real_scans_in_one_are_a_finding(real_data):
    drive = real_data / "data/drives/sequences/0004"
    poses = np.loadtxt(drive / "poses.txt").reshape(-1, 3, 4)[10:20]
    scans = [read_scan(path) for path in sorted((drive / "velodyne").iterdir())[10:20]]
    rotation, position = poses[-1, :, :3], poses[-1, :, 3]
    clouds = []
    for scan, pose in zip(scans, poses, strict=True):
        assert codes(scan, sensor("hdl64-512")) == set()
        points = scan.points[np.linalg.norm(scan.points, axis=1) > 1]
        clouds.append((points @ pose[:, :3].T + pose[:, 3] - position) @ rotation)
    assert codes(scan_of(np.concatenate(clouds)), sensor("hdl64-512")) == {"accumulated"}


IN_MAP = FileNotes(frame=(500_000.0, 5_400_000.0, 0.0))


def test_a_survey_that_shows_no_sensor_fails_with_what_helps():
    """A tile of a map, all of which is far from the origin of its frame."""
    random = np.random.default_rng(0)
    points = random.uniform((1000, 2000, 300), (1300, 2300, 301), (5000, 3))
    tile = replace(scan_of(points), notes=IN_MAP)
    with pytest.raises(FormatError, match="show no sensor") as caught:
        check_scan("tile.laz", tile, SMALL)
    assert "origin" in caught.value.hint
    assert "poses.txt" in caught.value.hint
    with pytest.raises(FormatError, match="median range"):
        check_scan("tile.bin", replace(tile, notes=FileNotes()), SMALL)


def test_several_scans_in_a_map_get_the_hint_of_a_survey():
    several = replace(sweeps(5), notes=IN_MAP)
    (finding,) = (f for f in check_scan("a", several, SMALL).findings if f.code == "accumulated")
    assert "origin" in finding.hint
