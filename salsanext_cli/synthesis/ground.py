# SPDX-License-Identifier: MIT
"""The ground as a mesh: a grid that is fine where the plan changes."""

import numpy as np

from salsanext_cli.synthesis import surfaces
from salsanext_cli.synthesis.mesh import Array, Mesh, Rng
from salsanext_cli.synthesis.plan import REACH_M, Plan
from salsanext_cli.synthesis.surfaces import Material

KERB_M = 0.02
"""Half the depth of a kerb's face; the grid has lines at this distance from every edge."""
MATERIAL_OF = {
    surfaces.ROAD: Material.ASPHALT,
    surfaces.MARKING: Material.MARKING,
    surfaces.PARKING: Material.PAVING,
    surfaces.SIDEWALK: Material.PAVING,
    surfaces.TERRAIN: Material.GRASS,
}


def ground(rng: Rng, plan: Plan) -> Mesh:
    """Return the ground of a street; each cell has the label of its middle."""
    s_edges, t_edges = plan.edges()
    s = _lines(np.arange(0.0, plan.length + 1, 1.0), s_edges, 0.0, plan.length)
    across = np.concatenate([np.arange(-10, 10.1, 0.5), np.linspace(10, REACH_M, 26)])
    t = _lines(np.concatenate([across, -across]), t_edges, -REACH_M, REACH_M)
    grid_s, grid_t = np.meshgrid(s, t, indexing="ij")
    vertices = plan.world(grid_s, grid_t)
    rough = (plan.label(grid_s, grid_t) == surfaces.TERRAIN) * rng.normal(0, 0.03, grid_s.shape)
    vertices[..., 2] += rough
    middle = plan.label(
        (grid_s[:-1, :-1] + grid_s[1:, 1:]) / 2, (grid_t[:-1, :-1] + grid_t[1:, 1:]) / 2
    )
    patches = _patches(rng, (s[:-1] + s[1:]) / 2, (t[:-1] + t[1:]) / 2, plan.length)
    labels = np.repeat(middle.ravel(), 2)
    materials = np.zeros(len(labels), np.uint8)
    shades = np.ones(len(labels), np.float32)
    for label, material in MATERIAL_OF.items():
        materials[labels == label] = material
        shades[labels == label] = rng.uniform(0.85, 1.15)
    shades *= np.repeat(patches.ravel(), 2).astype(np.float32)
    shades *= np.repeat(rng.normal(1, 0.03, middle.size), 2).astype(np.float32)
    index = np.arange(grid_s.size).reshape(grid_s.shape)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    faces = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)], 2)
    return Mesh(vertices.reshape(-1, 3), faces.reshape(-1, 3), labels, materials, shades)


def _patches(rng: Rng, s: Array, t: Array, length: float) -> Array:
    """Return the brightness of cells (s, t): mended asphalt, worn and wet places."""
    shade = np.ones((len(s), len(t)))
    for _ in range(int(length / 6)):
        centre = rng.uniform([0, -12], [length, 12])
        half = rng.uniform([0.4, 0.2], [9, 1.6])
        inside = (np.abs(s - centre[0]) < half[0])[:, None] & (np.abs(t - centre[1]) < half[1])
        shade[inside] *= rng.uniform(0.6, 1.2)
    return shade


def _lines(regular: Array, edges: Array, low: float, high: float) -> Array:
    lines: Array = np.unique(np.concatenate([regular, edges - KERB_M, edges + KERB_M]))
    lines = lines[(lines >= low) & (lines <= high)]
    apart: Array = lines[np.concatenate([[True], np.diff(lines) > 0.01])]
    return apart
