# SPDX-License-Identifier: MIT
"""Brightness of the materials of a street, which differs from street to street."""

import numpy as np

from salsanext_cli.synthesis.mesh import Array, Rng
from salsanext_cli.synthesis.presets import BRIGHTNESS, Material

GROUND = [Material.ASPHALT, Material.PAVING, Material.GRASS]
SIMILAR = 0.1  # Spread of materials that are nearly as bright as another


def draw_brightness(rng: Rng) -> Array:
    """Draw the relative brightness of every material in a street, (materials,)."""
    brightness = np.exp(rng.normal(0, BRIGHTNESS.street, len(Material)))
    if rng.random() < BRIGHTNESS.ground_alike:
        brightness[GROUND] = brightness[GROUND[0]] * np.exp(rng.normal(0, 0.08, len(GROUND)))
    else:
        brightness *= contrast(rng.uniform(*BRIGHTNESS.contrast_strength))
    grass = brightness[Material.GRASS]
    brightness[Material.HIGH_GRASS] = grass * np.exp(rng.normal(0, SIMILAR))
    dark = rng.random(len(Material)) < BRIGHTNESS.dark
    low, high = BRIGHTNESS.dark_brightness
    brightness[dark] = rng.uniform(low, high, int(dark.sum()))
    return np.clip(brightness, BRIGHTNESS.least, BRIGHTNESS.most)


def contrast(strength: float) -> Array:
    """Return the relative brightness of every material, (materials,), at a strength of 0 to 1.

    At 0 the materials are as bright as their optics say; at 1 asphalt, paving, plants and walls
    differ as their reflectances at 905 nm do.
    """
    exponents = np.zeros(len(Material))
    for name, exponent in BRIGHTNESS.contrast.items():
        exponents[Material[name]] = exponent
    relative: Array = np.exp(strength * exponents)
    return relative
