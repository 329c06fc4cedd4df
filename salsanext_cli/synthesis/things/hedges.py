# SPDX-License-Identifier: MIT
"""Hedges, clipped or ragged, and ivy: walls of leaves, rougher than walls of stone.

Local frame: x along the street, y away from it, the ground at z = 0.
"""

import numpy as np

from salsanext_cli.synthesis.mesh import Mesh, Rng, facets, merge, rings
from salsanext_cli.synthesis.things.vegetation import FOOT_M, leaf_skin

OUTLINE = np.array(
    [[-0.5, 0.0], [-0.52, 0.35], [-0.5, 0.7], [-0.42, 0.95], [0, 1.0]]
    + [[0.42, 0.95], [0.5, 0.7], [0.52, 0.35], [0.5, 0.0]]
)
"""Cross-section in shares of depth and height."""


def hedge(rng: Rng, length: float, height: float, depth: float, ragged: float = 0.05) -> Mesh:
    """Return a hedge from x = 0 to x = length: a rough core under a coat of leaves.

    ``ragged`` is the standard deviation of the surface in metres.
    """
    leaf = leaf_skin(rng)
    stations = np.linspace(0, length, max(3, int(length / 0.4)))
    section = OUTLINE * [depth * 0.9, height * 0.96]
    section[[0, -1], 1] = FOOT_M
    sides = section + rng.normal(0, ragged, (len(stations), len(section), 2))
    x = np.broadcast_to(stations[:, None, None], (*sides.shape[:2], 1))
    core = rings(np.concatenate([x, sides], -1), leaf)
    count = int(length * (height + depth) * rng.uniform(15, 45))
    place = rng.uniform([0, -0.5, 0], [1, 0.5, 1], (count, 3)) * [length, depth, height]
    outer, largest = rng.random(count), rng.uniform(0.04, 0.12)
    place[:, 1] = np.where(outer < 0.75, np.sign(place[:, 1]) * depth * 0.48, place[:, 1])
    place[:, 2] = np.where(outer >= 0.75, height, place[:, 2])
    place += rng.normal(0, ragged, place.shape)
    return merge([core, facets(place, rng.uniform(0.02, largest, count), leaf, rng)])


def ivy(rng: Rng, width: float, height: float) -> Mesh:
    """Return ivy on a wall at y = 0 from x = 0 to x = width, its upper edge uneven."""
    x = rng.uniform(0, width, int(60 * width * height))
    phase, wave = rng.uniform(0, 2 * np.pi, 3), rng.uniform(0.3, 3, 3)
    edge = height * (0.7 + 0.1 * np.sin(x[:, None] * wave + phase).sum(-1))
    y = -np.abs(rng.normal(0.05, 0.07, len(x)))
    places = np.stack([x, y, rng.uniform(0, 1, len(x)) * edge], -1)
    return facets(places, rng.uniform(0.08, 0.2, len(x)), leaf_skin(rng), rng)
