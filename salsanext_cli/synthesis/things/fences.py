# SPDX-License-Identifier: MIT
"""Fences, walls and barriers, which are one class, in pieces from x = 0 along x.

The class `fence` holds separators of all kinds: fences, small walls, crash barriers and noise
barriers.
"""

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from salsanext_cli.synthesis.mesh import Array, Mesh, Rng, Skin, box, extrusion, faces, merge
from salsanext_cli.synthesis.presets import FENCE, Material

Maker = Callable[[Rng, float, float, float], Mesh]
"""Returns a piece of a length, height and brightness."""
FOOT_M = -0.4  # Height of the foot of a fence: below the uneven ground
FENCES = (
    *["pickets"] * 3, *["railing"] * 5, *["mesh"] * 4, "boards", "wall", "plaster_wall",
    *["panels"] * 2, "parapet",
)  # fmt: skip
"""Kinds of fence around a lot, as likely as they are listed."""
WALLS = {"wall": Material.BRICK, "plaster_wall": Material.PLASTER, "concrete_wall": Material.PAVING}
"""Materials of kinds of wall."""
NOISE_BARRIERS = {
    "concrete_barrier": Material.PAVING,
    "wooden_barrier": Material.WOOD,
    "metal_barrier": Material.METAL,
}
"""Materials of kinds of noise barrier."""
GARDEN = (*WALLS, "boards", "panels")
"""Kinds that close off a garden to the eye."""
SOLID = (*GARDEN, *NOISE_BARRIERS, "hoarding")
"""Kinds that nothing shines through."""
PALE_SPREAD_M = 0.025  # Standard deviation of the upright pieces across a fence
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
PANEL_M = 1.8  # Length of a panel between two posts
SITE_PANEL_M = 2.5  # Length of a panel of a site fence, about: a piece has whole ones
NOISE_PANEL_M = 2.5  # The same of a noise barrier
PARAPET_SHARE = 0.4  # Share of the wall in the height of a wall with a railing


def fence(rng: Rng, length: float, kind: str, height: float, shade: float) -> Mesh:
    """Return a piece of a fence, wall or barrier.

    Parameters
    ----------
    rng
        Generator of the irregularities of the piece.
    length
        Length along x in metres.
    kind
        One of `KINDS`.
    height
        Height above the ground in metres; a crash barrier has its own.
    shade
        Relative brightness.
    """
    return KINDS[kind](rng, length, height, shade)


def _pales(kind: str) -> Maker:
    """Return a maker of a fence with upright pieces."""
    material, pitch, width = PALES[kind]

    def make(rng: Rng, length: float, height: float, shade: float) -> Mesh:
        skin = Skin(FENCE, material, shade)
        x = np.arange(0, length, pitch)
        top = height + rng.normal(0, 0.015, len(x))
        y = rng.normal(0, PALE_SPREAD_M, len(x))
        parts = [_strips(x, x + width, 0.03, top, y, skin=skin)]
        for post in np.arange(0, length, 2.2):
            parts.append(box((post, -0.05, FOOT_M), (post + 0.08, 0.05, height + 0.05), skin))
        for z in (0.2, height - 0.15):
            parts.append(box((0, 0.01, z - 0.04), (length, 0.05, z + 0.04), skin))
        if kind == "mesh":
            rows = np.arange(0.1, height, 0.12)
            parts.append(_strips(0.0, length, rows, rows + 0.018, 0.0, skin=skin))
        return merge(parts)

    return make


def _wall(material: Material) -> Maker:
    """Return a maker of a wall under a coping."""

    def make(_rng: Rng, length: float, height: float, shade: float) -> Mesh:
        skin = Skin(FENCE, material, shade)
        body = box((0, -0.12, FOOT_M), (length, 0.12, height), skin)
        return merge([body, box((0, -0.17, height), (length, 0.17, height + 0.07), skin)])

    return make


def _panels(rng: Rng, length: float, height: float, shade: float) -> Mesh:
    """Return a solid fence of wooden panels between posts, not quite in line."""
    skin = Skin(FENCE, Material.WOOD, shade)
    count = max(1, round(length / PANEL_M))
    edges = np.linspace(0, length, count + 1)
    parts = []
    for low, high in pairwise(edges):
        y = float(rng.normal(0, 0.01))
        top = height - float(abs(rng.normal(0, 0.02)))
        parts.append(box((low + 0.05, y - 0.015, 0.04), (high - 0.03, y + 0.015, top), skin))
        parts.append(box((low - 0.04, -0.045, FOOT_M), (low + 0.05, 0.045, height + 0.04), skin))
    return merge(parts)


def _parapet(rng: Rng, length: float, height: float, shade: float) -> Mesh:
    """Return a low wall with a railing on it."""
    wall = _wall(Material.BRICK)(rng, length, height * PARAPET_SHARE, shade)
    skin = Skin(FENCE, Material.METAL, shade)
    x = np.arange(0.05, length, 0.14)
    low = height * PARAPET_SHARE
    bars = _strips(x, x + 0.03, low, height, 0.0, skin=skin)
    rail = box((0, -0.02, height - 0.05), (length, 0.02, height), skin)
    return merge([wall, bars, rail])


def _site(rng: Rng, length: float, height: float, shade: float) -> Mesh:
    """Return mobile wire panels of a building site, which stand in blocks."""
    wire = Skin(FENCE, Material.METAL, shade)
    foot = Skin(FENCE, Material.RUBBER, 4 * shade)
    edges = np.linspace(0, length, max(1, round(length / SITE_PANEL_M)) + 1)
    parts = []
    for low, high in pairwise(edges):
        y = float(rng.normal(0, 0.06))
        x = np.arange(low + 0.1, high - 0.05, 0.1)
        parts.append(_strips(x, x + 0.012, 0.15, height, y, skin=wire))
        rows = np.arange(0.2, height, 0.25)
        parts.append(_strips(low + 0.05, high - 0.05, rows, rows + 0.012, y, skin=wire))
        for z in (0.15, height - 0.04):
            parts.append(box((low, y - 0.02, z), (high, y + 0.02, z + 0.04), wire))
        for post in (low, high - 0.04):
            parts.append(box((post, y - 0.02, 0.1), (post + 0.04, y + 0.02, height), wire))
        parts.append(box((low - 0.11, y - 0.35, -0.05), (low + 0.11, y + 0.35, 0.14), foot))
    return merge(parts)


def _hoarding(_rng: Rng, length: float, height: float, shade: float) -> Mesh:
    """Return closed boards around a building site, with posts behind."""
    skin = Skin(FENCE, Material.WOOD, shade)
    posts = [
        box((x, 0.02, FOOT_M), (x + 0.08, 0.12, height * 0.95), skin)
        for x in np.arange(0, length, 2.0)
    ]
    return merge([*posts, box((0, -0.015, 0.03), (length, 0.015, height), skin)])


def _noise_barrier(material: Material) -> Maker:
    """Return a maker of a noise barrier: ribbed panels between strong posts."""

    def make(rng: Rng, length: float, height: float, shade: float) -> Mesh:
        panel = Skin(FENCE, material, shade)
        post = Skin(FENCE, Material.METAL, 1.0)
        parts = [box((0, -0.06, FOOT_M), (length, 0.06, height), panel)]
        for x in np.linspace(0, length, max(1, round(length / NOISE_PANEL_M)) + 1):
            parts.append(box((x - 0.08, -0.1, FOOT_M), (x + 0.08, 0.1, height + 0.03), post))
        depth = float(rng.uniform(0.02, 0.05))
        for z in np.arange(0.25, height - 0.2, 0.5):
            parts.append(box((0, -0.06 - depth, z), (length, -0.06, z + 0.2), panel))
        return merge(parts)

    return make


def _crash_barrier(_rng: Rng, length: float, _height: float, shade: float) -> Mesh:
    """Return a steel crash barrier on posts."""
    skin = Skin(FENCE, Material.METAL, shade)
    at = np.arange(0, length, 2.0)
    posts = [box((x, 0.02, FOOT_M), (x + 0.1, 0.14, 0.72), skin) for x in at]
    beams = [box((0, -0.05, z), (length, 0.02, z + 0.12), skin) for z in (0.45, 0.63)]
    return merge([*posts, *beams, box((0, -0.01, 0.5), (length, 0.0, 0.7), skin)])


def _block(_rng: Rng, length: float, height: float, shade: float) -> Mesh:
    """Return a block of road works, or a concrete crash barrier."""
    skin = Skin(FENCE, Material.PAVING, shade)
    sections = np.stack(2 * [BLOCK_OUTLINE * [1, height]])
    return extrusion(np.array([0.0, length]), sections, skin)


def _strips(*edges: Array | float, skin: Skin) -> Mesh:
    """Return upright rectangles in planes y: left, right, lower and upper edges and y."""
    x0, x1, z0, z1, y = np.broadcast_arrays(*edges)
    corners = [np.stack(c, -1) for c in ((x0, y, z0), (x1, y, z0), (x1, y, z1), (x0, y, z1))]
    return faces(np.stack(corners, 1), skin)


KINDS: dict[str, Maker] = {
    **{kind: _pales(kind) for kind in PALES},
    **{kind: _wall(material) for kind, material in WALLS.items()},
    **{kind: _noise_barrier(material) for kind, material in NOISE_BARRIERS.items()},
    "panels": _panels,
    "parapet": _parapet,
    "site": _site,
    "hoarding": _hoarding,
    "barrier": _crash_barrier,
    "block": _block,
}
"""Makers of the kinds of fence: generator, length, height and brightness."""
