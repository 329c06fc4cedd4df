# SPDX-License-Identifier: MIT
"""The ground as a mesh: a grid that is fine where the plan changes."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from salsanext_cli.synthesis import surfaces
from salsanext_cli.synthesis.mesh import Array, Mesh, Skin
from salsanext_cli.synthesis.plan import REACH, Plan
from salsanext_cli.synthesis.surfaces import Material

KERB = 0.02
"""Half the depth of a kerb's face, metres: the grid has lines this far off every edge."""
MATERIAL_OF = {
    surfaces.ROAD: Material.ASPHALT,
    surfaces.MARKING: Material.MARKING,
    surfaces.PARKING: Material.PAVING,
    surfaces.SIDEWALK: Material.PAVING,
    surfaces.TERRAIN: Material.GRASS,
}


def ground(rng: np.random.Generator, plan: Plan) -> Mesh:
    """Return the ground of a street; each cell has the label of its middle."""
    s_edges, t_edges = plan.edges()
    s = _lines(np.arange(0.0, plan.length + 1, 1.0), s_edges, 0.0, plan.length)
    across = np.concatenate([np.arange(-10, 10.1, 0.5), np.linspace(10, REACH, 26)])
    t = _lines(np.concatenate([across, -across]), t_edges, -REACH, REACH)
    grid_s, grid_t = np.meshgrid(s, t, indexing="ij")
    vertices = plan.world(grid_s, grid_t)
    rough = (plan.label(grid_s, grid_t) == surfaces.TERRAIN) * rng.normal(0, 0.03, grid_s.shape)
    vertices[..., 2] += rough
    middle = plan.label(
        (grid_s[:-1, :-1] + grid_s[1:, 1:]) / 2, (grid_t[:-1, :-1] + grid_t[1:, 1:]) / 2
    )
    patches = _patches(rng, (s[:-1] + s[1:]) / 2, (t[:-1] + t[1:]) / 2, plan.length)
    labels, brightness = np.repeat(middle.ravel(), 2), np.repeat(patches.ravel(), 2)
    return _with_skins(rng, _grid(vertices), labels, brightness)


def _patches(rng: np.random.Generator, s: Array, t: Array, length: float) -> Array:
    """Return the brightness of cells (s, t): mended asphalt, worn and wet places."""
    shade = np.ones((len(s), len(t)))
    for _ in range(int(length / 6)):
        centre = rng.uniform([0, -12], [length, 12])
        half = rng.uniform([0.4, 0.2], [9, 1.6])
        inside = (np.abs(s - centre[0]) < half[0])[:, None] & (np.abs(t - centre[1]) < half[1])
        shade[inside] *= rng.uniform(0.6, 1.2)
    return shade


def _lines(regular: Array, edges: Array, low: float, high: float) -> Array:
    lines: Array = np.unique(np.concatenate([regular, edges - KERB, edges + KERB]))
    lines = lines[(lines >= low) & (lines <= high)]
    apart: Array = lines[np.concatenate([[True], np.diff(lines) > 0.01])]
    return apart


def _grid(vertices: Array) -> Mesh:
    rows, columns, _ = vertices.shape
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    faces = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)], 2)
    return Mesh.of(vertices.reshape(-1, 3), faces.reshape(-1, 3), Skin(0, Material.ASPHALT))


def _with_skins(
    rng: np.random.Generator, mesh: Mesh, labels: npt.NDArray[np.uint32], patches: Array
) -> Mesh:
    materials = np.zeros(len(mesh), np.uint8)
    shades = np.ones(len(mesh), np.float32)
    for label, material in MATERIAL_OF.items():
        materials[labels == label] = material
        shades[labels == label] = rng.uniform(0.85, 1.15)
    shades *= patches.astype(np.float32)
    shades *= np.repeat(rng.normal(1, 0.03, len(mesh) // 2), 2).astype(np.float32)
    return Mesh(mesh.vertices, mesh.triangles, labels, materials, shades)
