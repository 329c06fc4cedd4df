# SPDX-License-Identifier: MIT
"""Corrupted scans keep what they should, agree with closed forms, and get worse by severity."""

import runpy
from pathlib import Path

import numpy as np
import pytest

from salsanext_cli import Scan

MODULE = runpy.run_path(
    str(Path(__file__).parents[2] / "benchmarks/corruption_models.py"), run_name="models"
)
LEVELS = MODULE["LEVELS"]
DETECTABLE, ROAD, BUILDING = MODULE["DETECTABLE"], 40, 50
KINDS = pytest.mark.parametrize("kind", LEVELS)


def a_scan(count: int = 20_000, farthest: float = 70.0) -> tuple[Scan, np.ndarray]:
    """Return points on level ground and on walls; the number of each is in its label."""
    random = np.random.default_rng(0)
    azimuth = random.uniform(-np.pi, np.pi, count)
    elevation = np.radians(random.uniform(-25, 3, count))
    wall = random.uniform(3, farthest, count)
    ground = -1.7 / np.minimum(np.sin(elevation), -1e-3)
    ranges = np.minimum(wall, ground)
    flat = np.cos(elevation)
    points = ranges * [flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)]
    raw = np.where(ground < wall, ROAD, BUILDING).astype(np.uint32)
    labels = raw | (np.arange(count, dtype=np.uint32) << 16)
    intensity = random.random(count).astype(np.float32)
    return Scan(points.T.astype(np.float32), intensity), labels


def corrupted(kind: str, severity: int, scan: Scan, labels: np.ndarray, seed: int = 1):
    model, levels = LEVELS[kind]
    return model(scan, labels, levels[severity], np.random.default_rng(seed))


def on_one_ray(ranges: float, reflectivity: float, count: int) -> tuple[Scan, np.ndarray]:
    """Return the same echo many times."""
    points = np.tile(np.array([ranges, 0, 0], np.float32), (count, 1))
    intensity = np.full(count, reflectivity, np.float32)
    return Scan(points, intensity), np.full(count, BUILDING, np.uint32)


@KINDS
def test_none_changes_nothing(kind):
    scan, labels = a_scan()
    found, found_labels = corrupted(kind, 0, scan, labels)
    np.testing.assert_array_equal(found.points, scan.points)
    np.testing.assert_array_equal(found.intensity, scan.intensity)
    np.testing.assert_array_equal(found_labels, labels)


@KINDS
@pytest.mark.parametrize("severity", [1, 2, 3])
def test_labels_stay_with_their_points(kind, severity):
    """Points of the scene keep order and place; their intensity only falls."""
    scan, labels = a_scan(count=2**16 - 1)
    before = scan.points.copy(), scan.intensity.copy(), labels.copy()
    found, kept = corrupted(kind, severity, scan, labels)
    assert len(found) == len(kept) > 1000
    of_scene = kept != 0
    number = (kept >> 16)[of_scene]
    assert (np.diff(number.astype(int)) > 0).all()
    np.testing.assert_array_equal(kept[of_scene], labels[number])
    assert (found.intensity[of_scene] <= scan.intensity[number]).all()
    if kind != "motion blur":
        np.testing.assert_array_equal(found.points[of_scene], scan.points[number])
    # What is given is left as it was.
    for old, given in zip(before, (scan.points, scan.intensity, labels), strict=True):
        np.testing.assert_array_equal(old, given)


@pytest.mark.parametrize("reflectivity", [0.02, 0.2])
def test_share_of_fog_echoes(reflectivity):
    """One cell of fog before the surface: the integral of exp(-needed / mean) over it."""
    visibility, ranges = 50.0, 5.0
    scan, labels = on_one_ray(ranges, reflectivity, 40_000)
    _, kept = LEVELS["fog"][0](scan, labels, 1000 / visibility, np.random.default_rng(0))
    depth = np.linspace(2, 5, 3001)
    extinction = np.log(20) / visibility
    needed = reflectivity * np.exp(-2 * extinction * ranges) / ranges**2
    mean = np.pi * 0.046 / visibility * 3 * np.exp(-2 * extinction * depth) / depth**2
    share = np.exp(-needed / mean).mean()
    assert 0.001 < share < 0.9
    assert (kept == 0).mean() == pytest.approx(share, abs=4 * (share / 40_000) ** 0.5)


def test_wet_ground():
    """Straight down F = ((n − 1) / (n + 1))²; walls stay dry; far ground is lost."""
    down, far, wall = [0, 0, -1.7], [30, 0, -1.7], [30, 1, 0]
    scan = Scan(np.array([down, far, wall], np.float32), np.full(3, 0.2, np.float32))
    labels = np.array([ROAD, ROAD, BUILDING], np.uint32)
    found, kept = corrupted("wet ground", 3, scan, labels)
    assert kept.tolist() == [ROAD, BUILDING]
    reflected = (0.33 / 2.33) ** 2
    expected = 0.2 * (1 - reflected) ** 2 / 1.33**2 / (1 - 0.48 * 0.2)
    np.testing.assert_allclose(found.intensity, [expected, 0.2], rtol=1e-6)
    half, _ = corrupted("wet ground", 2, scan, labels)
    assert half.intensity[0] == pytest.approx((0.2 + expected) / 2)
