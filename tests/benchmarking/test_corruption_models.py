# SPDX-License-Identifier: MIT
"""Corrupted scans keep what they should, and agree with closed forms."""

import numpy as np
import pytest
from corruption_models import LEVELS
from scans import make_scan

from salsanext_cli import Scan

ROAD, BUILDING = 40, 50


def corrupted(kind: str, severity: int, scan: Scan, labels: np.ndarray):
    model, levels = LEVELS[kind]
    return model(scan, labels, levels[severity], np.random.default_rng(1))


@pytest.mark.parametrize("kind", LEVELS)
def test_points_of_the_scene_keep_order_label_and_place(kind):
    """Their intensity only falls; nothing changes at severity 0, nor what is given."""
    scan = make_scan(2**16 - 1)
    raw = np.where(scan.points[:, 2] < -1.69, ROAD, BUILDING)
    labels = (raw | np.arange(len(scan)) << 16).astype(np.uint32)
    before = scan.points.copy(), scan.intensity.copy(), labels.copy()
    for severity in range(4):
        found, kept = corrupted(kind, severity, scan, labels)
        assert len(found) == len(kept) > 1000
        of_scene = kept != 0
        number = (kept >> 16)[of_scene]
        assert (np.diff(number.astype(int)) > 0).all()
        np.testing.assert_array_equal(kept[of_scene], labels[number])
        assert (found.intensity[of_scene] <= scan.intensity[number]).all()
        if kind != "motion blur" or severity == 0:
            np.testing.assert_array_equal(found.points[of_scene], scan.points[number])
        if severity == 0:
            np.testing.assert_array_equal(kept, labels)
            np.testing.assert_array_equal(found.intensity, scan.intensity)
        for old, given in zip(before, (scan.points, scan.intensity, labels), strict=True):
            np.testing.assert_array_equal(old, given)


@pytest.mark.parametrize("reflectivity", [0.02, 0.2])
def test_share_of_fog_echoes(reflectivity):
    """One cell of fog before the surface: the integral of exp(-needed / mean) over it."""
    visibility, ranges, count = 50.0, 5.0, 40_000
    points = np.tile(np.array([ranges, 0, 0], np.float32), (count, 1))
    scan = Scan(points, np.full(count, reflectivity, np.float32))
    labels = np.full(count, BUILDING, np.uint32)
    _, kept = LEVELS["fog"][0](scan, labels, 1000 / visibility, np.random.default_rng(0))
    depth = np.linspace(2, 5, 3001)
    extinction = np.log(20) / visibility
    needed = reflectivity * np.exp(-2 * extinction * ranges) / ranges**2
    mean = np.pi * 0.046 / visibility * 3 * np.exp(-2 * extinction * depth) / depth**2
    share = np.exp(-needed / mean).mean()
    assert 0.001 < share < 0.9
    assert (kept == 0).mean() == pytest.approx(share, abs=4 * (share / count) ** 0.5)


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
