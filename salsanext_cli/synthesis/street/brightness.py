# SPDX-License-Identifier: MIT
"""Brightness of materials: other in each street, so that intensity alone tells few classes."""

from dataclasses import replace

import numpy as np

from salsanext_cli.synthesis.mesh import Array, Mesh, Rng
from salsanext_cli.synthesis.presets import BRIGHTNESS
from salsanext_cli.synthesis.surfaces import Material

LEAST, MOST = BRIGHTNESS["least"], BRIGHTNESS["most"]
DARK, WET = BRIGHTNESS["dark_brightness"], BRIGHTNESS["wet_brightness"]


def draw_brightness(rng: Rng) -> Array:
    """Draw the brightness of each material in a street, (materials,), relative to the usual."""
    of_material = np.exp(rng.normal(0, BRIGHTNESS["street"], len(Material)))
    dark = rng.random(len(Material)) < BRIGHTNESS["dark"]
    of_material[dark] = rng.uniform(DARK[0], DARK[1], int(dark.sum()))
    return np.clip(of_material, LEAST, MOST)


def with_brightness(mesh: Mesh, of_material: Array) -> Mesh:
    """Return a mesh with its shades multiplied by the brightness of each material.

    `of_material` is (materials,); no shade is more than the most in the presets.
    """
    shades = np.clip(mesh.shades * of_material[mesh.materials], 0, MOST).astype(np.float32)
    return replace(mesh, shades=shades)


def varied(mesh: Mesh, rng: Rng) -> Mesh:
    """Return an object, its materials a little brighter or darker than others'."""
    return with_brightness(mesh, np.exp(rng.normal(0, BRIGHTNESS["object"], len(Material))))


def patches(rng: Rng, s: Array, t: Array, length: float) -> Array:
    """Return the brightness of cells (s, t): mended asphalt, worn and wet places, tracks."""
    shade = np.ones((len(s), len(t)))
    for _ in range(int(length / 6)):
        centre = rng.uniform([0, -12], [length, 12])
        half = rng.uniform([0.4, 0.2], [9, 1.6]) * rng.choice([1, 1, 1, 3])
        inside = (np.abs(s - centre[0]) < half[0])[:, None] & (np.abs(t - centre[1]) < half[1])
        wet = rng.random() < BRIGHTNESS["wet_patch"]
        factor = rng.uniform(*WET) if wet else np.exp(rng.normal(0, BRIGHTNESS["patch"]))
        shade[inside] *= factor
    return np.clip(shade, LEAST, MOST)
