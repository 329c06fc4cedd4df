# SPDX-License-Identifier: MIT
"""Brightness of materials: other in each street, so that intensity alone tells no class."""

from dataclasses import replace

import numpy as np

from salsanext_cli.synthesis.mesh import Array, Mesh, Rng
from salsanext_cli.synthesis.presets import BRIGHTNESS
from salsanext_cli.synthesis.surfaces import Material

LEAST, MOST = BRIGHTNESS["least"], BRIGHTNESS["most"]
DARK, WET = BRIGHTNESS["dark_level"], BRIGHTNESS["wet_level"]


def draw_tones(rng: Rng) -> Array:
    """Return how bright each material of a street is, (materials,), relative to the usual."""
    tones = np.exp(rng.normal(0, BRIGHTNESS["street"], len(Material)))
    dark = rng.random(len(Material)) < BRIGHTNESS["dark"]
    tones[dark] = rng.uniform(DARK[0], DARK[1], int(dark.sum()))
    return np.clip(tones, LEAST, MOST)


def toned(mesh: Mesh, tones: Array) -> Mesh:
    """Return a mesh whose materials have the brightness of a street's."""
    shades = np.clip(mesh.shades * tones[mesh.materials], 0, MOST).astype(np.float32)
    return replace(mesh, shades=shades)


def varied(mesh: Mesh, rng: Rng) -> Mesh:
    """Return an object, its materials a little brighter or darker than others'."""
    return toned(mesh, np.exp(rng.normal(0, BRIGHTNESS["object"], len(Material))))


def patches(rng: Rng, s: Array, t: Array, length: float) -> Array:
    """Return the brightness of cells (s, t): mended asphalt, worn and wet places, tracks."""
    shade = np.ones((len(s), len(t)))
    for _ in range(int(length / 6)):
        centre = rng.uniform([0, -12], [length, 12])
        half = rng.uniform([0.4, 0.2], [9, 1.6]) * rng.choice([1, 1, 1, 3])
        inside = (np.abs(s - centre[0]) < half[0])[:, None] & (np.abs(t - centre[1]) < half[1])
        wet = rng.random() < BRIGHTNESS["wet_patch"]
        level = (
            rng.uniform(*BRIGHTNESS["wet_level"])
            if wet
            else np.exp(rng.normal(0, BRIGHTNESS["patch"]))
        )
        shade[inside] *= level
    return np.clip(shade, LEAST, MOST)
