# SPDX-License-Identifier: MIT
"""Brightness of the materials of a street, which differs from street to street."""

from collections.abc import Mapping

import numpy as np

from salsanext_cli.synthesis.mesh import Array, Rng
from salsanext_cli.synthesis.presets import BRIGHTNESS, Material

GROUND = [Material.ASPHALT, Material.PAVING, Material.GRASS]
SIMILAR = 0.1  # Spread of materials that are nearly as bright as another


def draw_brightness(rng: Rng) -> Array:
    """Draw the relative brightness of every material in a street, (materials,)."""
    brightness = np.exp(rng.normal(0, SPREAD))
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


def by_material(numbers: Mapping[str, float], default: float) -> Array:
    """Return a number per material, (materials,), `default` for those that are not named."""
    values = np.full(len(Material), default)
    for name, value in numbers.items():
        values[Material[name]] = value
    return values


def contrast(strength: float) -> Array:
    """Return the relative brightness of every material, (materials,), at a strength of 0 to 1.

    At 0 the materials are as bright as their optics say; at 1 asphalt, paving, plants and walls
    differ as their reflectances at 905 nm do.
    """
    relative: Array = np.exp(strength * by_material(BRIGHTNESS.contrast, 0.0))
    return relative


SPREAD = by_material(BRIGHTNESS.street_of, BRIGHTNESS.street)
"""Standard deviation of the logarithm of the brightness of a material over streets."""
