# SPDX-License-Identifier: MIT
"""Fences, walls, railings and crash barriers from x = 0 to x = length, the ground at z = 0."""

from __future__ import annotations

import numpy as np

from salsanext_cli.synthesis.ids import FENCE
from salsanext_cli.synthesis.materials import Material
from salsanext_cli.synthesis.mesh import Mesh, Skin, merge
from salsanext_cli.synthesis.shapes import box, quads

FOOT = -0.4
KINDS = ("pickets", "boards", "wall", "railing", "mesh")


def fence(rng: np.random.Generator, length: float, kind: str, height: float, shade: float) -> Mesh:
    """Return a stretch of fence of one of `KINDS`, or ``"barrier"``."""
    if kind == "wall":
        return _wall(length, height, shade)
    if kind == "barrier":
        return _barrier(length, shade)
    if kind in ("pickets", "boards"):
        pitch, width = (0.16, 0.09) if kind == "pickets" else (0.21, 0.2)
        skin = Skin(FENCE, Material.WOOD, shade)
        return merge(
            [_uprights(rng, length, height, pitch, width, skin), *_rails(length, height, skin)]
        )
    skin = Skin(FENCE, Material.METAL, shade)
    pitch, width = (0.13, 0.035) if kind == "railing" else (0.1, 0.018)
    parts = [_uprights(rng, length, height, pitch, width, skin), *_rails(length, height, skin)]
    if kind == "mesh":
        rows = np.arange(0.1, height, 0.12)
        parts.append(
            _strips(np.zeros(len(rows)), np.full(len(rows), length), rows, rows + 0.018, skin)
        )
    return merge(parts)


def _strips(x0: np.ndarray, x1: np.ndarray, z0: np.ndarray, z1: np.ndarray, skin: Skin) -> Mesh:
    """Return upright rectangles in the plane y = 0."""
    y = np.zeros(len(x0))
    corners = [np.stack(c, -1) for c in ((x0, y, z0), (x1, y, z0), (x1, y, z1), (x0, y, z1))]
    return quads(np.stack(corners, 1), skin)


def _uprights(
    rng: np.random.Generator, length: float, height: float, pitch: float, width: float, skin: Skin
) -> Mesh:
    x = np.arange(0, length, pitch)
    top = height + rng.normal(0, 0.015, len(x))
    thin = _strips(x, x + width, np.full(len(x), 0.03), top, skin)
    posts = np.arange(0, length, 2.2)
    thick = [box((p, -0.05, FOOT), (p + 0.08, 0.05, height + 0.05), skin) for p in posts]
    return merge([thin, *thick])


def _rails(length: float, height: float, skin: Skin) -> list[Mesh]:
    return [box((0, 0.01, z - 0.04), (length, 0.05, z + 0.04), skin) for z in (0.2, height - 0.15)]


def _wall(length: float, height: float, shade: float) -> Mesh:
    skin = Skin(FENCE, Material.BRICK, shade)
    body = box((0, -0.12, FOOT), (length, 0.12, height), skin)
    coping = box((0, -0.17, height), (length, 0.17, height + 0.07), skin)
    return merge([body, coping])


def _barrier(length: float, shade: float) -> Mesh:
    skin = Skin(FENCE, Material.METAL, shade)
    posts = [box((x, 0.02, FOOT), (x + 0.1, 0.14, 0.72), skin) for x in np.arange(0, length, 2.0)]
    beams = [box((0, -0.05, z), (length, 0.02, z + 0.12), skin) for z in (0.45, 0.63)]
    return merge([*posts, *beams, box((0, -0.01, 0.5), (length, 0.0, 0.7), skin)])
