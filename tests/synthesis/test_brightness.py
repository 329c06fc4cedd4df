# SPDX-License-Identifier: MIT
"""Brightness of materials over many streets: each from dark to bright, independent of others."""

import numpy as np

from salsanext_cli.synthesis.mesh import Skin, box
from salsanext_cli.synthesis.presets import BRIGHTNESS
from salsanext_cli.synthesis.street.brightness import draw_brightness, patches, with_brightness
from salsanext_cli.synthesis.surfaces import ROAD, Material

OF_STREETS = np.array([draw_brightness(np.random.default_rng(seed)) for seed in range(300)])


def test_every_material_is_dark_in_some_streets_and_bright_in_others():
    assert (OF_STREETS.min(0) < 0.4).all()
    assert (OF_STREETS.max(0) > 1.4).all()
    np.testing.assert_allclose(np.median(OF_STREETS, 0), 1, atol=0.15)
    assert BRIGHTNESS["least"] <= OF_STREETS.min()
    assert OF_STREETS.max() <= BRIGHTNESS["most"]


def test_materials_vary_independently_of_each_other():
    correlations = np.corrcoef(OF_STREETS.T)[np.triu_indices(len(Material), 1)]
    assert np.abs(correlations).max() < 0.25


def test_a_mesh_has_the_brightness_of_its_materials():
    mesh = box((0, 0, 0), (1, 1, 1), Skin(ROAD, Material.BRICK, 0.5))
    of_material = np.ones(len(Material))
    of_material[Material.BRICK] = 0.4
    np.testing.assert_allclose(with_brightness(mesh, of_material).shades, 0.2, rtol=1e-6)
    np.testing.assert_allclose(mesh.shades, 0.5)


def test_patches_darken_some_metres_of_the_ground():
    s, t = np.arange(0, 200, 0.5), np.arange(-10, 10, 0.5)
    shade = patches(np.random.default_rng(0), s, t, 200.0)
    assert shade.shape == (len(s), len(t))
    assert 0.2 < (shade == 1).mean() < 0.95
    assert (shade < 0.5).mean() > 0.01
