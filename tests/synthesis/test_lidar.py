# SPDX-License-Identifier: MIT
"""Simulated measurement against closed forms: a wall, a floor, glass, nothing, two scenes."""

import numpy as np
import pytest

from salsanext_cli.synthesis.lidar import INTENSITY_NOISE, USUAL_ECHO, Lasers, Scene, measure
from salsanext_cli.synthesis.mesh import Skin, faces
from salsanext_cli.synthesis.presets import BUILDING, CAR, HDL64, ROAD, Material, Numbers


def wall(distance, material=Material.PLASTER, label=BUILDING, shade=1.0):
    """Build a wall across x, 200 m wide and high."""
    x, w = distance, 100.0
    corners = np.array([[[x, -w, -w], [x, w, -w], [x, w, w], [x, -w, w]]])
    return Scene(faces(corners, Skin(label, material, shade)))


def floor(material):
    """Build a road 1.73 m below the sensor."""
    z, w = -1.73, 300.0
    corners = np.array([[[-w, -w, z], [w, -w, z], [w, w, z], [-w, w, z]]])
    return Scene(faces(corners, Skin(ROAD, material)))


def fan(count=20_000, spread=0.3):
    """Return rays from the origin, forward, within `spread` radians to either side."""
    azimuth = np.linspace(-spread, spread, count)
    directions = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(count)], -1)
    return np.concatenate([np.zeros((count, 3)), directions], 1), azimuth


def look(scenes, rays, seed=0, power=1.0, response=HDL64):
    ones = np.ones(len(rays))
    lasers = Lasers(ones, 0 * ones, power * ones)
    return measure(np.random.default_rng(seed), scenes, rays, lasers, response)


def test_a_wall_has_the_right_distance():
    rays, azimuth = fan()
    distance, intensity, labels = look([wall(10)], rays)
    returned = np.isfinite(distance)
    error = distance[returned] - 10 / np.cos(azimuth[returned])
    assert returned.mean() > 0.98
    assert abs(error.mean()) < 1e-3
    assert error.std() == pytest.approx(HDL64.noise, rel=0.05)
    assert set(labels[returned]) == {BUILDING}
    np.testing.assert_allclose(intensity * 100, np.round(intensity * 100), atol=1e-9)
    usual = Material.PLASTER.optics[0]
    assert intensity[returned].mean() == pytest.approx(usual, abs=0.05)


@pytest.mark.parametrize(
    ("material", "factors"), [(Material.GRASS, (1, 2.5, 4)), (Material.BARK, (1, 1, 1))]
)
def test_grass_is_the_rougher_the_farther_away_it_is(material, factors):
    for reach, factor in zip((6.0, 20.0, 40.0), factors, strict=True):
        rays, azimuth = fan(spread=0.05)
        distance, *_ = look([wall(reach, material)], rays)
        returned = np.isfinite(distance)
        error = distance[returned] - reach / np.cos(azimuth[returned])
        expected = np.hypot(HDL64.noise, factor * material.optics[4])
        assert error.std() == pytest.approx(expected, rel=0.05)


def test_roads_seen_at_a_grazing_angle_fade_out():
    scene = floor(Material.ASPHALT)

    def share(reach):
        direction = np.array([reach, 0, -1.73]) / np.hypot(reach, 1.73)
        rays = np.tile(np.concatenate([np.zeros(3), direction]), (4000, 1))
        distance, intensity, _ = look([scene], rays)
        return np.isfinite(distance).mean(), intensity.mean()

    shares, brightness = zip(*(share(reach) for reach in (8, 25, 50, 75)), strict=True)
    assert shares[0] > 0.98
    assert shares[0] >= shares[1] > shares[2] > shares[3]
    assert brightness[0] > brightness[1] > brightness[2]


def test_glass_and_dark_paint_lose_pulses_in_runs():
    rays, _ = fan()
    shares = {}
    for name, material, shade in (
        ("plaster", Material.PLASTER, 1.0),
        ("bright paint", Material.PAINT, 1.2),
        ("dark paint", Material.PAINT, 0.05),
        ("glass", Material.GLASS, 1.0),
    ):
        distance, _, _ = look([wall(8, material, CAR, shade)], rays)
        shares[name] = np.isfinite(distance).mean()
    assert shares["plaster"] > shares["bright paint"] > shares["dark paint"] > shares["glass"]
    distance, _, _ = look([wall(8, Material.PAINT, CAR, 0.05)], rays)
    lost = ~np.isfinite(distance)
    share = lost.mean()
    # Independent losses would follow a loss no more often than a return.
    assert (lost[1:] & lost[:-1]).mean() > 1.5 * share**2


def test_the_nearer_of_two_scenes_counts_and_nothing_returns_from_afar_or_too_near():
    rays, _ = fan(100)
    for x in (-10.0, 200.0, 0.8):
        distance, _, _ = look([wall(x)], rays)
        assert np.isnan(distance).all()
    rays, _ = fan(500)
    near, far = wall(6, label=CAR), wall(12)
    for scenes in ([near, far], [far, near]):
        distance, _, labels = look(scenes, rays)
        returned = np.isfinite(distance)
        assert set(labels[returned]) == {CAR}
        assert distance[returned].max() < 7


@pytest.mark.parametrize("echo", [USUAL_ECHO, 0.5 * USUAL_ECHO, 0.3 * USUAL_ECHO])
def test_gamma_darkens_dark_surfaces_and_changes_no_range(echo):
    rays, _ = fan(4000, spread=0.03)
    at_13_m = wall(13, shade=echo / Material.PLASTER.optics[0])
    usual = look([at_13_m], rays)
    other = look([at_13_m], rays, response=Numbers(**vars(HDL64) | {"gamma": 1.6}))
    np.testing.assert_array_equal(usual[0], other[0])
    before, after = (seen[1].mean() + INTENSITY_NOISE for seen in (usual, other))
    assert before == pytest.approx(echo, rel=0.03)
    assert after / before == pytest.approx((echo / USUAL_ECHO) ** 0.6, rel=0.05)
