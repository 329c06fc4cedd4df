# SPDX-License-Identifier: MIT
"""Fences, walls, crash barriers, hedges and ivy, `length` metres long."""

import numpy as np

from salsanext_cli.synthesis.mesh import (
    Array,
    Mesh,
    Rng,
    Skin,
    box,
    extrusion,
    facets,
    merge,
    quads,
)
from salsanext_cli.synthesis.surfaces import FENCE, Material
from salsanext_cli.synthesis.things.vegetation import FOOT_M, leaf_skin

FENCES = (*["pickets"] * 3, *["railing"] * 5, *["mesh"] * 4, "boards", "wall")
PALE_SPREAD_M = 0.025  # Standard deviation of the upright pieces across a fence
CLIPPED_M = 0.03  # Largest unevenness of a clipped hedge, whose leaves are small and dense
PALES = {
    "pickets": (Material.WOOD, 0.2, 0.09),
    "boards": (Material.WOOD, 0.21, 0.2),
    "railing": (Material.METAL, 0.13, 0.035),
    "mesh": (Material.METAL, 0.1, 0.018),
}
"""Material, distance and width of the upright pieces, metres."""
BLOCK_OUTLINE = np.array(
    [[-0.3, 0], [-0.3, 0.08], [-0.15, 0.35], [-0.09, 1], [0.09, 1], [0.15, 0.35], [0.3, 0.08]]
    + [[0.3, 0]]
)
"""Cross-section of a block of road works, in metres and in shares of its height."""
HEDGE_OUTLINE = np.array(
    [[-0.5, 0.0], [-0.52, 0.35], [-0.5, 0.7], [-0.42, 0.95], [0, 1.0]]
    + [[0.42, 0.95], [0.5, 0.7], [0.52, 0.35], [0.5, 0.0]]
)
"""Cross-section of a hedge in shares of depth and height."""


def fence(rng: Rng, length: float, kind: str, height: float, shade: float) -> Mesh:
    """Return a fence, one of `FENCES`, a crash ``"barrier"`` or a ``"block"`` of road works."""
    if kind == "block":
        skin = Skin(FENCE, Material.PAVING, shade)
        sections = np.stack(2 * [BLOCK_OUTLINE * [1, height]])
        return extrusion(np.array([0.0, length]), sections, skin)
    if kind == "wall":
        skin = Skin(FENCE, Material.BRICK, shade)
        body = box((0, -0.12, FOOT_M), (length, 0.12, height), skin)
        return merge([body, box((0, -0.17, height), (length, 0.17, height + 0.07), skin)])
    if kind == "barrier":
        skin = Skin(FENCE, Material.METAL, shade)
        at = np.arange(0, length, 2.0)
        posts = [box((x, 0.02, FOOT_M), (x + 0.1, 0.14, 0.72), skin) for x in at]
        beams = [box((0, -0.05, z), (length, 0.02, z + 0.12), skin) for z in (0.45, 0.63)]
        return merge([*posts, *beams, box((0, -0.01, 0.5), (length, 0.0, 0.7), skin)])
    material, pitch, width = PALES[kind]
    skin = Skin(FENCE, material, shade)
    x = np.arange(0, length, pitch)
    top, y = height + rng.normal(0, 0.015, len(x)), rng.normal(0, PALE_SPREAD_M, len(x))
    parts = [_strips(x, x + width, 0.03, top, y, skin=skin)]
    for post in np.arange(0, length, 2.2):
        parts.append(box((post, -0.05, FOOT_M), (post + 0.08, 0.05, height + 0.05), skin))
    for z in (0.2, height - 0.15):
        parts.append(box((0, 0.01, z - 0.04), (length, 0.05, z + 0.04), skin))
    if kind == "mesh":
        rows = np.arange(0.1, height, 0.12)
        parts.append(_strips(0.0, length, rows, rows + 0.018, 0.0, skin=skin))
    return merge(parts)


def _strips(*edges: Array | float, skin: Skin) -> Mesh:
    """Return upright rectangles in planes y: left, right, lower and upper edges and y."""
    x0, x1, z0, z1, y = np.broadcast_arrays(*edges)
    corners = [np.stack(c, -1) for c in ((x0, y, z0), (x1, y, z0), (x1, y, z1), (x0, y, z1))]
    return quads(np.stack(corners, 1), skin)


def hedge(rng: Rng, length: float, height: float, depth: float, ragged: float) -> Mesh:
    """Return a hedge under leaves, its surface with a standard deviation of `ragged` metres."""
    leaf = leaf_skin(rng)
    stations = np.linspace(0, length, max(3, int(length / 0.4)))
    section = HEDGE_OUTLINE * [depth * 0.9, height * 0.96]
    section[[0, -1], 1] = FOOT_M
    sides = section + rng.normal(0, ragged, (len(stations), len(section), 2))
    core = extrusion(stations, sides, leaf)
    clipped = ragged <= CLIPPED_M
    count = int(length * (height + depth) * rng.uniform(15, 45) * (1 + 0.4 * clipped))
    centres = rng.uniform([0, -0.5, 0], [1, 0.5, 1], (count, 3)) * [length, depth, height]
    outer, largest = rng.random(count), rng.uniform(*(0.025, 0.05) if clipped else (0.04, 0.12))
    centres[:, 1] = np.where(outer < 0.75, np.sign(centres[:, 1]) * depth * 0.48, centres[:, 1])
    centres[:, 2] = np.where(outer >= 0.75, height, centres[:, 2])
    centres += rng.normal(0, ragged, centres.shape)
    return merge([core, facets(centres, rng.uniform(0.02, largest, count), leaf, rng)])


def ivy(rng: Rng, length: float, height: float) -> Mesh:
    """Return ivy with an uneven upper edge on a wall at y = 0."""
    x = rng.uniform(0, length, int(60 * length * height))
    phase, wave = rng.uniform(0, 2 * np.pi, 3), rng.uniform(0.3, 3, 3)
    edge = height * (0.7 + 0.1 * np.sin(x[:, None] * wave + phase).sum(-1))
    y = -np.abs(rng.normal(0.05, 0.07, len(x)))
    places = np.stack([x, y, rng.uniform(0, 1, len(x)) * edge], -1)
    return facets(places, rng.uniform(0.08, 0.2, len(x)), leaf_skin(rng), rng)
