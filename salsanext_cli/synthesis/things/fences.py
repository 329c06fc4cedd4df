# SPDX-License-Identifier: MIT
"""Fences: pickets, boards, bars, wire, walls and crash barriers.

Local frame: x along the street, y away from it, the ground at z = 0.
"""

import numpy as np

from salsanext_cli.synthesis.mesh import Mesh, Rng, Skin, box, merge, quads
from salsanext_cli.synthesis.surfaces import FENCE, Material

FOOT_M = -0.4
"""Height of the foot of walls and posts: below the ground, which is not level."""
FENCES = ("pickets", "pickets", *["railing"] * 3, *["mesh"] * 3, "boards", "wall")
PALES = {
    "pickets": (Material.WOOD, 0.16, 0.09),
    "boards": (Material.WOOD, 0.21, 0.2),
    "railing": (Material.METAL, 0.13, 0.035),
    "mesh": (Material.METAL, 0.1, 0.018),
}
"""Material, distance and width of the upright pieces, metres."""


def fence(rng: Rng, length: float, kind: str, height: float, shade: float) -> Mesh:
    """Return a fence from x = 0 to x = length, one of `FENCES` or a crash ``"barrier"``."""
    if kind == "wall":
        skin = Skin(FENCE, Material.BRICK, shade)
        body = box((0, -0.12, FOOT_M), (length, 0.12, height), skin)
        return merge([body, box((0, -0.17, height), (length, 0.17, height + 0.07), skin)])
    if kind == "barrier":
        return _barrier(length, Skin(FENCE, Material.METAL, shade))
    material, pitch, width = PALES[kind]
    skin = Skin(FENCE, material, shade)
    x = np.arange(0, length, pitch)
    parts = [_strips(x, x + width, 0.03, height + rng.normal(0, 0.015, len(x)), skin=skin)]
    for post in np.arange(0, length, 2.2):
        parts.append(box((post, -0.05, FOOT_M), (post + 0.08, 0.05, height + 0.05), skin))
    for z in (0.2, height - 0.15):
        parts.append(box((0, 0.01, z - 0.04), (length, 0.05, z + 0.04), skin))
    if kind == "mesh":
        rows = np.arange(0.1, height, 0.12)
        parts.append(_strips(0.0, length, rows, rows + 0.018, skin=skin))
    return merge(parts)


def _strips(*edges: np.ndarray | float, skin: Skin) -> Mesh:
    """Return upright rectangles in the plane y = 0: left, right, lower and upper edges."""
    x0, x1, z0, z1, y = np.broadcast_arrays(*edges, 0.0)
    corners = [np.stack(c, -1) for c in ((x0, y, z0), (x1, y, z0), (x1, y, z1), (x0, y, z1))]
    return quads(np.stack(corners, 1), skin)


def _barrier(length: float, skin: Skin) -> Mesh:
    posts = [box((x, 0.02, FOOT_M), (x + 0.1, 0.14, 0.72), skin) for x in np.arange(0, length, 2.0)]
    beams = [box((0, -0.05, z), (length, 0.02, z + 0.12), skin) for z in (0.45, 0.63)]
    return merge([*posts, *beams, box((0, -0.01, 0.5), (length, 0.0, 0.7), skin)])
