# SPDX-License-Identifier: MIT
"""Trees, bushes, thickets, hedges and ivy: many small facets that let some rays through."""

import numpy as np

from salsanext_cli.synthesis.mesh import (
    Array,
    Mesh,
    Rng,
    Skin,
    ellipsoid,
    extrusion,
    facets,
    merge,
    tube,
)
from salsanext_cli.synthesis.presets import TRUNK, VEGETATION, Material

THIN_M = 0.06  # Largest radius of a stem with the label of vegetation
FOOT_M = -0.4  # Height of the foot of trunks and stems, below the uneven ground
CLIPPED_M = 0.03  # Largest unevenness of a clipped hedge, whose leaves are small and dense
HEDGE_OUTLINE = np.array(
    [[-0.5, 0.0], [-0.52, 0.35], [-0.5, 0.7], [-0.42, 0.95], [0, 1.0]]
    + [[0.42, 0.95], [0.5, 0.7], [0.52, 0.35], [0.5, 0.0]]
)
"""Cross-section of a hedge in shares of depth and height."""


def leaf_skin(rng: Rng, material: Material = Material.LEAF) -> Skin:
    """Draw the brightness of dense leaves, or of loose `Material.FOLIAGE`."""
    return Skin.random(rng, VEGETATION, material, 0.7, 1.25)


def _leaves(
    rng: Rng, centre: Array, radii: Array, count: int, sizes: tuple[float, float], leaf: Skin
) -> Mesh:
    """Return leaves that are denser towards the rim of an ellipsoid."""
    direction = rng.standard_normal((count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    reach = rng.uniform(0.3, 1.0, (count, 1)) ** 0.5 + rng.normal(0, 0.08, (count, 1))
    return facets(centre + direction * reach * radii, rng.uniform(*sizes, count), leaf, rng)


def _lumps(rng: Rng, spread: float) -> Array:
    return spread * rng.standard_normal((6, 8, 1)).clip(-2, 2)


def tree(rng: Rng, height: float) -> Mesh:
    """Return a broad-leaved tree: bent trunk, branches, a crown of clusters."""
    bark = Skin.random(rng, TRUNK, Material.BARK, 0.5, 1.15)
    branch = bark._replace(label=VEGETATION)
    radius = float(rng.uniform(0.018, 0.06) * height**0.75)
    clear = max(rng.uniform(0.2, 0.5) * height, 1.8 if rng.random() < 0.5 else 0.0)
    dense = rng.random() < 0.4
    bend = rng.normal(0, 0.05 * height, (2,))
    heights = np.array([FOOT_M, 0.0, 0.4, clear * 0.5, clear, clear * 1.5])
    share = np.clip(heights / heights[-1], 0, 1)[:, None]
    path = np.concatenate([bend * share**1.5, heights[:, None]], 1)
    swell = np.array([1.7, 1.4, 1.1, 0.95, 0.85, 0.5])
    parts = [tube(path, radius * swell, bark, 9)]
    spread = height * rng.uniform(0.2, 0.34)
    leaf = leaf_skin(rng, Material.FOLIAGE)
    for _ in range(int(rng.integers(5, 9))):
        angle = rng.uniform(0, 2 * np.pi)
        out = np.array([np.cos(angle), np.sin(angle)]) * spread * rng.uniform(0.3, 1)
        root = path[4] * [1, 1, rng.uniform(0.75, 1.0)]
        tip = np.array([*(bend + out), rng.uniform(clear * 1.1, height * 0.85)])
        knee = (root + tip) / 2 + [0, 0, rng.uniform(-0.2, 0.4)]
        parts.append(tube([root, knee, tip], radius * np.array([0.5, 0.35, 0.12]), branch, 6))
        size = spread * rng.uniform(0.4, 0.75, 3)
        parts.append(_leaves(rng, tip, size, int(rng.uniform(260, 500)), (0.08, 0.22), leaf))
        if dense:
            parts.append(ellipsoid(tip, size * 0.85, leaf, _lumps(rng, 0.12)))
    return merge(parts)


def conifer(rng: Rng, height: float) -> Mesh:
    """Return a conifer, its branches reaching down."""
    bark = Skin(TRUNK, Material.BARK, 0.8)
    base = float(rng.uniform(0.1, 0.9))
    radius = height * rng.uniform(0.16, 0.26)
    count = int(110 * height)
    share = 1 - np.sqrt(rng.uniform(0, 1, count))
    angle = rng.uniform(0, 2 * np.pi, count)
    reach = radius * (1 - share) * np.sqrt(rng.uniform(0.25, 1, count)) + rng.normal(0, 0.06, count)
    z = base + share * (height - base) - 0.25 * reach
    centres = np.stack([reach * np.cos(angle), reach * np.sin(angle), z], -1)
    leaf = leaf_skin(rng, Material.FOLIAGE)
    trunk = tube([[0, 0, FOOT_M], [0, 0, height * 0.8]], [0.025 * height, 0.05], bark)
    return merge([trunk, facets(centres, rng.uniform(0.1, 0.26, count), leaf, rng)])


def bush(rng: Rng, radius: float) -> Mesh:
    """Return a bush of one to four lumps."""
    leaf = leaf_skin(rng)
    parts = []
    for _ in range(int(rng.integers(1, 5))):
        size = radius * rng.uniform([0.5, 0.5, 0.5], [1, 1, 1.3])
        centre = np.array([*rng.normal(0, radius * 0.4, 2), size[2] * 0.7])
        parts.append(ellipsoid(centre, size * 0.7, leaf, _lumps(rng, 0.15)))
        parts.append(_leaves(rng, centre, size, int(130 + 160 * radius), (0.04, 0.14), leaf))
    return merge(parts)


def thicket(rng: Rng, length: float, depth: float, height: float) -> Mesh:
    """Return undergrowth from x = 0 to x = length, y = 0 to y = depth: bushes, stems, crowns."""
    leaf = leaf_skin(rng, Material.FOLIAGE)
    bark = Skin(TRUNK, Material.BARK, 0.85)
    parts = []
    dense = rng.choice([0.3, 0.9])
    for _ in range(max(2, int(length * depth / 5))):
        x = rng.uniform(0, length)
        y = rng.uniform(0, depth)
        low = rng.uniform(0.15, 0.55) * height * (0.5 + 0.5 * y / depth)
        size = np.array([*rng.uniform(0.7, 1.8, 2), low])
        centre = np.array([x, y, low * 0.6])
        if rng.random() < dense:
            parts.append(ellipsoid(centre, size * 0.6, leaf, _lumps(rng, 0.2)))
        parts.append(_leaves(rng, centre, size, int(rng.uniform(150, 330)), (0.04, 0.2), leaf))
    for _ in range(max(1, int(length / 4))):
        x = rng.uniform(0, length)
        y = rng.uniform(depth * 0.2, depth)
        lean = rng.normal(0, 0.5, 2)
        top = np.array([x + lean[0], y + lean[1], height * rng.uniform(0.6, 1.1)])
        radius = rng.uniform(0.1, 0.25) if rng.random() < 0.25 else rng.uniform(0.03, 0.13)
        stem = bark if radius > THIN_M else bark._replace(label=VEGETATION)
        parts.append(tube([np.array([x, y, FOOT_M]), top], [radius, 0.03], stem, 6))
        parts.append(_leaves(rng, top, np.array([2.0, 2.0, height * 0.3]), 260, (0.12, 0.32), leaf))
    return merge(parts)


def ground_cover(rng: Rng, radius: float) -> Mesh:
    """Return ground cover 0.05 to 0.5 m high, lower towards its rim."""
    leaf = leaf_skin(rng)
    height = rng.uniform(0.05, 0.5) * min(1.0, radius)
    count = int(140 * radius**2)
    places = rng.uniform(-1, 1, (count, 2))
    rise = np.clip(1 - (places**2).sum(1), 0, 1) ** 0.4 * rng.uniform(0.4, 1.0, count)
    centres = np.column_stack([places * radius, rise * height])[rise > 0]
    size = rng.uniform(0.03, 0.12, len(centres))
    core = ellipsoid((0, 0, 0), [0.9 * radius, 0.9 * radius, 0.6 * height], leaf, _lumps(rng, 0.15))
    return merge([core, facets(centres, size, leaf, rng)])


def weeds(rng: Rng, radius: float) -> Mesh:
    """Return a patch of tall grass and weeds."""
    count = int(70 * radius)
    centres = rng.normal(0, radius * 0.5, (count, 3))
    centres[:, 2] = rng.uniform(0.0, 0.45, count) * rng.uniform(0.3, 1.0)
    leaf = Skin.random(rng, VEGETATION, Material.LEAF, 0.8, 1.15)
    return facets(centres, rng.uniform(0.04, 0.14, count), leaf, rng)


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
    outer = rng.random(count)
    sizes = (0.025, 0.05) if clipped else (0.04, 0.12)
    largest = rng.uniform(*sizes)
    centres[:, 1] = np.where(outer < 0.75, np.sign(centres[:, 1]) * depth * 0.48, centres[:, 1])
    centres[:, 2] = np.where(outer >= 0.75, height, centres[:, 2])
    centres += rng.normal(0, ragged, centres.shape)
    return merge([core, facets(centres, rng.uniform(0.02, largest, count), leaf, rng)])


def ivy(rng: Rng, length: float, height: float) -> Mesh:
    """Return ivy with an uneven upper edge on a wall at y = 0."""
    x = rng.uniform(0, length, int(60 * length * height))
    phase = rng.uniform(0, 2 * np.pi, 3)
    wave = rng.uniform(0.3, 3, 3)
    edge = height * (0.7 + 0.1 * np.sin(x[:, None] * wave + phase).sum(-1))
    y = -np.abs(rng.normal(0.05, 0.07, len(x)))
    places = np.stack([x, y, rng.uniform(0, 1, len(x)) * edge], -1)
    return facets(places, rng.uniform(0.08, 0.2, len(x)), leaf_skin(rng), rng)
