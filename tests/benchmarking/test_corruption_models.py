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
FOG_PER_KM = LEVELS["fog"][1]
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


@KINDS
def test_seeded(kind):
    scan, labels = a_scan()
    first, again, other = (corrupted(kind, 2, scan, labels, seed) for seed in (5, 5, 6))
    np.testing.assert_array_equal(first[0].points, again[0].points)
    np.testing.assert_array_equal(first[1], again[1])
    if kind not in ("wet ground", "other sensor"):
        same = first[0].points.shape == other[0].points.shape
        assert not same or (first[0].points != other[0].points).any()


@pytest.mark.parametrize("kind", [kind for kind in LEVELS if kind not in ("motion blur", "snow")])
def test_severer_ones_lose_points_of_the_milder(kind):
    """With steps of 2, 3 and 4, other sensors only lose more."""
    scan, labels = a_scan(count=2**16 - 1)
    left = [set(corrupted(kind, s, scan, labels)[1][:]) - {0} for s in (0, 1, 2, 3)]
    assert len(left[0]) > len(left[1]) > len(left[2]) > len(left[3])
    if kind != "other sensor":
        assert left[0] > left[1] > left[2] > left[3]


def test_more_snow_hides_more():
    scan, labels = a_scan()
    hidden = [(corrupted("snow", s, scan, labels)[1] == 0).sum() for s in (0, 1, 2, 3)]
    assert hidden[0] < 5
    assert hidden[0] < hidden[1] < hidden[2] < hidden[3]


@pytest.mark.parametrize("kind", ["fog", "snow", "crosstalk"])
def test_echoes_of_no_scene_are_on_the_rays_of_the_scan(kind):
    scan, labels = a_scan(farthest=20)
    labels = np.full_like(labels, BUILDING)
    found, kept = corrupted(kind, 3, scan, labels)
    assert len(found) == len(scan)  # so that points can be compared in order
    echo = kept == 0
    assert 0.01 < echo.mean() < 0.8
    old, new = (points[echo].astype(float) for points in (scan.points, found.points))
    cosine = (old * new).sum(1) / np.linalg.norm(old, axis=1) / np.linalg.norm(new, axis=1)
    np.testing.assert_allclose(cosine, 1, atol=1e-6)
    assert np.linalg.norm(new, axis=1).min() >= 2 - 1e-4
    if kind != "crosstalk":
        assert (np.linalg.norm(new, axis=1) < np.linalg.norm(old, axis=1) + 1e-4).all()
    assert (found.intensity <= 1).all()


@pytest.mark.parametrize("kind", ["fog", "wet ground", "snow", "crosstalk", "incomplete echo"])
def test_points_without_a_measurement_stay(kind):
    scan, labels = a_scan(count=500)
    points = scan.points.copy()
    points[3], points[7] = np.nan, 0
    found, kept = corrupted(kind, 3, Scan(points, scan.intensity), labels)
    numbers = (kept >> 16).tolist()
    assert np.isnan(found.points[numbers.index(3)]).all()
    assert (found.points[numbers.index(7)] == 0).all()
    assert np.isnan(found.points).any(axis=1).sum() == 1


@pytest.mark.parametrize("per_km", FOG_PER_KM[1:])
def test_fog_before_the_nearest_echo_only_weakens(per_km):
    """At a visibility V an echo from V / 2 has a twentieth of its strength."""
    scan, labels = on_one_ray(1.5, 0.8, 10)
    fog = LEVELS["fog"][0]
    found, kept = fog(scan, labels, per_km, np.random.default_rng(0))
    np.testing.assert_array_equal(kept, labels)
    expected = 0.8 * 20.0 ** (-2 * 1.5 * per_km / 1000)
    np.testing.assert_allclose(found.intensity, expected, rtol=1e-6)


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


def test_share_of_flakes():
    """Flakes drawn one by one hide the surface where one is nearer and stronger."""
    rate, ranges, reflectivity, count = 2.5, 12.0, 0.1, 4000
    scan, labels = on_one_ray(ranges, reflectivity, 20_000)
    _, kept = LEVELS["snow"][0](scan, labels, rate, np.random.default_rng(0))
    random = np.random.default_rng(1)
    per_mm = 2.55 * rate**-0.48
    per_m3 = 3800 * rate**-0.87 / per_mm
    area = np.pi / 4 * 2.15**2 * 2 / per_mm**2 * per_m3 / 1e6
    surface = reflectivity * np.exp(-2 * area * ranges) / ranges**2
    hidden = 0
    for _ in range(count):
        strongest = 0.0
        for start in range(2, 12):
            beam = 0.01 + 0.002 * (start + 0.5)
            flakes = random.poisson(per_m3 * np.pi / 4 * beam**2)
            for diameter in 2.15e-3 * random.exponential(1 / per_mm, flakes):
                strongest = max(strongest, 0.9 * (diameter / beam / (start + 0.5)) ** 2)
        hidden += strongest > surface
    share = hidden / count
    assert 0.05 < share < 0.95
    assert (kept == 0).mean() == pytest.approx(share, abs=4 * 0.5 / count**0.5)


def test_motion_blur():
    """A quarter of a revolution later, a sensor at 8 m/s is 0.2 m farther forward."""
    left = np.tile(np.array([0, 10, 0], np.float32), (40_000, 1))
    scan = Scan(left, np.zeros(len(left), np.float32))
    labels = np.full(len(left), BUILDING, np.uint32)
    found, kept = corrupted("motion blur", 2, scan, labels)
    moved = found.points - left
    np.testing.assert_allclose(moved.mean(axis=0), [-0.2, 0, 0], atol=0.001)
    np.testing.assert_allclose(moved.std(axis=0), 0.02, rtol=0.02)
    assert kept is labels


@pytest.mark.parametrize(("kind", "left"), [("missing beams", 8), ("other sensor", 11)])
def test_beams_are_rings_where_these_are_known(kind, left):
    scan, labels = a_scan()
    ring = np.random.default_rng(2).integers(0, 32, len(scan)).astype(np.int32)
    found, kept = corrupted(
        kind, 3 if left == 8 else 2, Scan(scan.points, scan.intensity, ring), labels
    )
    rings = np.unique(found.ring)
    assert len(rings) == left
    np.testing.assert_array_equal(kept, labels[np.isin(ring, rings)])
    if kind == "other sensor":
        assert (rings % 3 == 0).all()


def test_crosstalk_hits_its_share():
    scan, labels = on_one_ray(20, 0.3, 50_000)
    found, kept = corrupted("crosstalk", 3, scan, labels)
    assert (kept == 0).mean() == pytest.approx(0.05, abs=0.004)
    ranges = found.points[kept == 0, 0]
    assert ranges.mean() == pytest.approx(41, abs=3)
    assert (ranges.min(), ranges.max()) == pytest.approx((2, 80), abs=1)


def test_half_of_the_echoes_at_the_threshold_are_lost():
    near, far = on_one_ray(10, 0.4, 20_000), on_one_ray(20, 0.4, 20_000)
    points = np.concatenate([near[0].points, far[0].points])
    scan = Scan(points, np.full(len(points), 0.4, np.float32))
    labels = np.repeat(np.array([ROAD, BUILDING], np.uint32), 20_000)
    _, kept = corrupted("incomplete echo", 2, scan, labels)
    assert (kept == BUILDING).sum() / 20_000 == pytest.approx(0.5, abs=0.015)
    assert (kept == ROAD).sum() / 20_000 == pytest.approx(1 / (1 + 4**-2.2), abs=0.015)


def test_what_was_below_the_threshold_was_detected_all_the_same():
    """A scan may hold weaker echoes than the model's sensor: clear air loses none."""
    scan, labels = on_one_ray(200, 0.05, 10)
    assert DETECTABLE > 0.05 / 200**2
    found, _ = LEVELS["fog"][0](scan, labels, 0.0, np.random.default_rng(0))
    assert len(found) == 10
    found, _ = LEVELS["fog"][0](scan, labels, 1e-6, np.random.default_rng(0))
    assert len(found) == 0
