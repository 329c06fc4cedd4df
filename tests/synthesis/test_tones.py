# SPDX-License-Identifier: MIT
"""Brightness of materials over many streets: intensity alone tells no class."""

import numpy as np

from salsanext_cli.synthesis.mesh import Skin, box
from salsanext_cli.synthesis.presets import BRIGHTNESS
from salsanext_cli.synthesis.street.tones import draw_tones, patches, toned
from salsanext_cli.synthesis.surfaces import ROAD, Material

TONES = np.array([draw_tones(np.random.default_rng(seed)) for seed in range(300)])


def test_every_material_is_dark_in_some_streets_and_bright_in_others():
    assert (TONES.min(0) < 0.4).all()
    assert (TONES.max(0) > 1.4).all()
    np.testing.assert_allclose(np.median(TONES, 0), 1, atol=0.15)
    assert BRIGHTNESS["least"] <= TONES.min()
    assert TONES.max() <= BRIGHTNESS["most"]


def test_no_two_materials_are_dark_together():
    asphalt, leaf = TONES[:, Material.ASPHALT], TONES[:, Material.LEAF]
    assert abs(np.corrcoef(asphalt, leaf)[0, 1]) < 0.2


def test_a_toned_mesh_has_the_brightness_of_its_materials():
    mesh = box((0, 0, 0), (1, 1, 1), Skin(ROAD, Material.BRICK, 0.5))
    tones = np.ones(len(Material))
    tones[Material.BRICK] = 0.4
    np.testing.assert_allclose(toned(mesh, tones).shades, 0.2, rtol=1e-6)
    np.testing.assert_allclose(mesh.shades, 0.5)


def test_patches_darken_some_metres_of_the_ground():
    s, t = np.arange(0, 200, 0.5), np.arange(-10, 10, 0.5)
    shade = patches(np.random.default_rng(0), s, t, 200.0)
    assert shade.shape == (len(s), len(t))
    assert 0.2 < (shade == 1).mean() < 0.95
    assert (shade < 0.5).mean() > 0.01
