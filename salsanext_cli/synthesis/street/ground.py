# SPDX-License-Identifier: MIT
"""Mesh of the ground of a street with its materials and patches."""

import numpy as np

from salsanext_cli.synthesis import surfaces
from salsanext_cli.synthesis.mesh import Array, Mesh, Rng
from salsanext_cli.synthesis.presets import BRIGHTNESS
from salsanext_cli.synthesis.street.plan import KERB_M, REACH_M, Plan
from salsanext_cli.synthesis.surfaces import Material

PAVED = (Material.PAVING, Material.PAVING, Material.PAVING, Material.ASPHALT)
"""Materials of paved ground, as likely as they are frequent here."""
SAME_SURFACE = (
    (surfaces.PARKING, surfaces.ROAD), (surfaces.SIDEWALK, surfaces.PARKING),
    (surfaces.OTHER_GROUND, surfaces.SIDEWALK),
)  # fmt: skip
"""Ground that may have the surface of another, so that only its location differs."""


def ground(rng: Rng, plan: Plan) -> Mesh:
    """Return the ground of a street; a cell has the label of its middle."""
    s_edges, t_edges = plan.edges()
    s = _lines(np.arange(0.0, plan.length + 1, 1.0), s_edges, 0.0, plan.length)
    across = np.concatenate([np.arange(-10, 10.1, 0.5), np.linspace(10, REACH_M, 26)])
    t = _lines(np.concatenate([across, -across]), t_edges, -REACH_M, REACH_M)
    grid_s, grid_t = np.meshgrid(s, t, indexing="ij")
    vertices = plan.world(grid_s, grid_t)
    is_terrain = plan.label(grid_s, grid_t) == surfaces.TERRAIN
    vertices[..., 2] += np.where(is_terrain, 0.03, 0.006) * rng.standard_normal(grid_s.shape)
    middle = plan.label(
        (grid_s[:-1, :-1] + grid_s[1:, 1:]) / 2, (grid_t[:-1, :-1] + grid_t[1:, 1:]) / 2
    )
    patchwork = _patches(rng, (s[:-1] + s[1:]) / 2, (t[:-1] + t[1:]) / 2, plan.length)
    labels = np.repeat(middle.ravel(), 2)
    materials = np.zeros(len(labels), np.uint8)
    shades = np.ones(len(labels), np.float32)
    materials_of = {
        surfaces.ROAD: Material.PAVING if rng.random() < 0.12 else Material.ASPHALT,
        surfaces.MARKING: Material.MARKING,
        surfaces.PARKING: PAVED[rng.integers(4)],
        surfaces.SIDEWALK: PAVED[rng.integers(4)],
        surfaces.OTHER_GROUND: (*PAVED, Material.GRASS)[rng.integers(5)],
        surfaces.TERRAIN: Material.GRASS,
    }
    spread = rng.choice(BRIGHTNESS.ground)
    looks = {a: (m, rng.uniform(1 - spread, 1 + spread)) for a, m in materials_of.items()}
    for label, other in SAME_SURFACE:
        if rng.random() < BRIGHTNESS.same_surface:
            looks[label] = looks[other]
    for label, (material, shade) in looks.items():
        materials[labels == label] = material
        shades[labels == label] = shade
    shades *= np.repeat(patchwork.ravel(), 2).astype(np.float32)
    shades *= np.repeat(rng.normal(1, 0.03, middle.size), 2).astype(np.float32)
    index = np.arange(grid_s.size).reshape(grid_s.shape)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    faces = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)], 2)
    return Mesh(vertices.reshape(-1, 3), faces.reshape(-1, 3), labels, materials, shades)


def _lines(regular: Array, edges: Array, low: float, high: float) -> Array:
    lines: Array = np.unique(np.concatenate([regular, edges - KERB_M, edges + KERB_M]))
    lines = lines[(lines >= low) & (lines <= high)]
    return lines[np.concatenate([[True], np.diff(lines) > 0.01])]


def _patches(rng: Rng, s: Array, t: Array, length: float) -> Array:
    """Return the brightness of cells (S, T): repaired, worn and wet patches, tracks."""
    shade = np.ones((len(s), len(t)))
    for _ in range(int(length / 6)):
        centre = rng.uniform([0, -12], [length, 12])
        half = rng.uniform([0.4, 0.2], [9, 1.6]) * rng.choice([1, 1, 1, 3])
        inside = (np.abs(s - centre[0]) < half[0])[:, None] & (np.abs(t - centre[1]) < half[1])
        if rng.random() < BRIGHTNESS.wet_patch:
            shade[inside] *= rng.uniform(*BRIGHTNESS.wet_brightness)
        else:
            shade[inside] *= np.exp(rng.normal(0, BRIGHTNESS.patch))
    return np.clip(shade, BRIGHTNESS.least, BRIGHTNESS.most)
