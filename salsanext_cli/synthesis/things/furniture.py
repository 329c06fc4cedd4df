# SPDX-License-Identifier: MIT
"""Objects at the roadside: poles, lamps, signs, bins, benches, cabinets, shelters."""

from itertools import pairwise

import numpy as np

from salsanext_cli.synthesis.mesh import Mesh, Rng, Skin, box, disc, ellipsoid, faces, merge, tube
from salsanext_cli.synthesis.presets import CLUTTER, POLE, SIGN, STRUCTURE, Material

FOOT_M = -0.3  # Height of the foot of poles and boxes: below the uneven ground


def _steel(rng: Rng) -> Skin:
    return Skin.random(rng, POLE, Material.METAL, 0.08, 1.6)


def lamp(rng: Rng) -> Mesh:
    """Return a street lamp, its arm over the road."""
    steel = _steel(rng)
    height = float(rng.uniform(3.5, 9))
    foot = float(rng.uniform(0.05, 0.1))
    heights = (FOOT_M, 1.1, 1.2, height)
    radii = (foot * 1.35, foot * 1.35, foot, foot * 0.6)
    parts = [tube([[0, 0, z] for z in heights], radii, steel)]
    if height > 5:
        tip = (0.0, -rng.uniform(0.8, 2.2), height + 0.3)
        parts += [tube([[0, 0, height - 0.1], tip], 0.05, steel, 5)]
        parts += [box((-0.15, tip[1] - 0.5, tip[2] - 0.1), (0.15, tip[1], tip[2]), steel)]
    else:
        parts.append(ellipsoid((0, 0, height), (0.22, 0.22, 0.3), steel))
    return merge(parts)


def post(rng: Rng) -> Mesh:
    """Return a bollard or a bare pole."""
    short = rng.random() < 0.6
    height = rng.uniform(0.7, 1.2) if short else rng.uniform(2.5, 8)
    radius = rng.uniform(0.04, 0.09)
    return tube([[0, 0, FOOT_M], [0, 0, height]], radius, _steel(rng), 8)


def _face(rng: Rng) -> Mesh:
    """Return a sign's plate in the x-z plane around the origin, its bright side towards -y."""
    kind = ("round", "triangle", "panel")[rng.integers(3)]
    bright = Skin.random(rng, SIGN, Material.RETRO, 0.75, 1.1)
    radius = float(rng.uniform(0.28, 0.45))
    if kind == "round":
        front = disc((0, 0, 0), radius, bright, 14)
    elif kind == "triangle":
        r = radius * 1.25
        x = radius * 1.1
        front = faces(np.array([[[-x, 0, -r / 2], [x, 0, -r / 2], [0, 0, r], [0, 0, r]]]), bright)
    else:
        x = radius * rng.uniform(0.6, 1.6)
        z = radius * rng.uniform(0.5, 1.2)
        front = faces(np.array([[[-x, 0, -z], [x, 0, -z], [x, 0, z], [-x, 0, z]]]), bright)
    back = Mesh.uniform(
        front.vertices + [0, 0.02, 0], front.triangles, Skin(SIGN, Material.METAL, 0.9)
    )
    return merge([front, back])


def sign(rng: Rng) -> Mesh:
    """Return one or two traffic signs on a pole, facing -y."""
    height = float(rng.uniform(2.0, 3.0) if rng.random() < 0.75 else rng.uniform(1.0, 2.0))
    parts = [tube([[0, 0, FOOT_M], [0, 0, height + 0.35]], rng.uniform(0.03, 0.05), _steel(rng), 7)]
    for place in range(int(rng.integers(1, 3))):
        parts.append(_face(rng).moved((0, -0.07, height - 0.75 * place)))
    return merge(parts)


def board(rng: Rng) -> Mesh:
    """Return a direction board on two posts, facing -y."""
    half = float(rng.uniform(0.4, 1.4))
    low = float(rng.uniform(0.8, 1.8))
    high = low + float(rng.uniform(0.5, 1.2))
    steel = _steel(rng)
    bright = Skin.random(rng, SIGN, Material.RETRO, 0.6, 1.1)
    parts = [tube([[x, 0, FOOT_M], [x, 0, high]], 0.05, steel) for x in (-half * 0.8, half * 0.8)]
    plate = np.array([[[-half, 0, low], [half, 0, low], [half, 0, high], [-half, 0, high]]])
    parts.append(faces(plate - [0, 0.08, 0], bright))
    parts.append(faces(plate - [0, 0.06, 0], Skin(SIGN, Material.METAL, 0.9)))
    return merge(parts)


def hoop(rng: Rng) -> Mesh:
    """Return a hoop along x to which bicycles are locked."""
    steel = Skin.random(rng, CLUTTER, Material.METAL, 0.5, 1.3)
    half, height = rng.uniform([0.3, 0.7], [0.45, 0.9])
    corners = [[-half, 0, FOOT_M], [-half, 0, height], [half, 0, height], [half, 0, FOOT_M]]
    return merge([tube([a, b], 0.025, steel, 5) for a, b in pairwise(corners)])


def traffic_light(rng: Rng) -> Mesh:
    """Return a traffic light with the label pole, and clutter for its heads."""
    height = float(rng.uniform(3.0, 3.6))
    head = Skin(CLUTTER, Material.METAL, 0.4)
    parts = [tube([[0, 0, FOOT_M], [0, 0, height]], 0.07, _steel(rng))]
    for low in (height - 1.0, 1.9)[: int(rng.integers(1, 3))]:
        parts.append(box((-0.16, -0.36, low), (0.16, -0.08, low + 0.9), head))
    return merge(parts)


def _dustbin(rng: Rng) -> Mesh:
    skin = Skin.random(rng, CLUTTER, Material.WOOD, 0.2, 1.1)
    x, y, z = rng.uniform([0.2, 0.2, 0.8], [0.35, 0.4, 1.15])
    lid = box((-x - 0.02, -y - 0.05, z), (x + 0.02, y, z + 0.08), skin)
    return merge([box((-x, -y, 0.05), (x, y, z), skin), lid])


def _cabinet(rng: Rng) -> Mesh:
    skin = Skin.random(rng, CLUTTER, Material.PLASTER, 0.5, 1.1)
    x, y, z = rng.uniform([0.25, 0.12, 0.8], [0.9, 0.3, 1.6])
    return box((-x, -y, FOOT_M), (x, y, z), skin)


def bench(rng: Rng) -> Mesh:
    """Return a bench, its back away from the road."""
    wood = Skin(CLUTTER, Material.WOOD, 0.9)
    iron = Skin(CLUTTER, Material.METAL, 0.7)
    half = float(rng.uniform(0.7, 1.1))
    slats = [box((-half, y, 0.42), (half, y + 0.1, 0.46), wood) for y in (-0.25, -0.12, 0.01)]
    slats += [box((-half, 0.18, z), (half, 0.22, z + 0.1), wood) for z in (0.55, 0.72)]
    ends = (-half + 0.2, half - 0.2)
    legs = [box((x - 0.03, -0.25, FOOT_M), (x + 0.03, 0.2, 0.42), iron) for x in ends]
    return merge(slats + legs)


def _planter(rng: Rng) -> Mesh:
    skin = Skin.random(rng, CLUTTER, Material.BRICK, 0.7, 1.1)
    radius = float(rng.uniform(0.25, 0.7))
    height = float(rng.uniform(0.35, 0.7))
    path = [[0, 0, FOOT_M], [0, 0, height], [0, 0, height + 0.01]]
    return tube(path, [radius, radius * 1.1, 0.02], skin, 10)


def _column(rng: Rng) -> Mesh:
    skin = Skin.random(rng, CLUTTER, Material.PLASTER, 0.7, 1.1)
    return tube([[0, 0, FOOT_M], [0, 0, 3.0], [0, 0, 3.3]], [0.6, 0.6, 0.75], skin, 12)


def _crates(rng: Rng) -> Mesh:
    parts = []
    for _ in range(int(rng.integers(2, 6))):
        low = np.array([*rng.normal(0, 0.6, 2), 0.0])
        size = rng.uniform([0.2, 0.2, 0.15], [0.8, 0.6, 0.9])
        skin = Skin.random(rng, CLUTTER, Material.WOOD, 0.4, 1.1)
        parts.append(box(low, low + size, skin).moved(yaw=rng.uniform(0, 1.5)))
    return merge(parts)


def clutter(rng: Rng) -> Mesh:
    """Return a dustbin, cabinet, bench, planter, advertising column or a heap of crates."""
    makers = (*[_dustbin] * 3, *[_cabinet] * 3, bench, _planter, _column, _crates)
    return makers[rng.integers(len(makers))](rng)


def shelter(rng: Rng) -> Mesh:
    """Return a bus shelter of glass, open towards -y."""
    steel = Skin(STRUCTURE, Material.METAL, 0.9)
    glass = Skin(STRUCTURE, Material.GLASS)
    half = float(rng.uniform(1.2, 2.2))
    parts = [box((x - 0.04, y - 0.04, FOOT_M), (x + 0.04, y + 0.04, 2.4), steel)
             for x in (-half, 0, half) for y in (0, 1.3)]  # fmt: skip
    parts.append(box((-half - 0.1, -0.2, 2.4), (half + 0.1, 1.4, 2.5), steel))
    parts.append(box((-half, 1.29, 0.15), (half, 1.31, 2.2), glass))
    parts.append(box((-half, 0, 0.15), (-half + 0.02, 1.3, 2.2), glass))
    return merge(parts)
